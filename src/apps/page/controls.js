  // ---- turning, zooming, moving
  function turnBy(x, y) {
    const about = (i, j, angle) => {
      const [a, b] = [view.turn[i], view.turn[j]], c = Math.cos(angle), s = Math.sin(angle);
      view.turn[i] = a.map((x, k) => c * x + s * b[k]);
      view.turn[j] = b.map((x, k) => c * x - s * a[k]);
    };
    about(0, 2, x);
    about(2, 1, y);
    draw();
  }
  function zoomBy(factor) {
    const zoom = Math.min(60, Math.max(.2, view.zoom * factor));
    view.shift = view.shift.map((x) => x * zoom / view.zoom);
    view.zoom = zoom;
    draw();
  }
  function moveBy(x, y) {
    view.shift[0] += 2 * x / canvas.clientWidth;
    view.shift[1] -= 2 * y / canvas.clientHeight;
    draw();
  }
  const fingers = new Map();
  let moved = 0, stroke = null, tapped = { time: -Infinity };
  function drawStroke() {
    $('stroke').toggleAttribute('hidden', !stroke || moved < 6);
    if (stroke) ['x1', 'y1', 'x2', 'y2'].forEach((name, k) => $('stroke').firstElementChild.setAttribute(name, stroke[k]));
  }
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 1) moved = 0;
    const box = canvas.getBoundingClientRect(), at = [event.clientX - box.left, event.clientY - box.top];
    stroke = mode === 'cut' && fingers.size === 1 && event.button === 0 && !event.shiftKey ? [...at, ...at] : null;
    drawStroke();
  });
  canvas.addEventListener('pointermove', (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return hover(event);
    const [x, y] = [event.clientX - before[0], event.clientY - before[1]];
    moved += Math.abs(x) + Math.abs(y);
    const other = [...fingers.entries()].find(([id]) => id !== event.pointerId);
    if (other) {
      const span = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
      zoomBy(span([event.clientX, event.clientY]) / span(before));
      moveBy(x / 2, y / 2);
    } else if (stroke) {
      [stroke[2], stroke[3]] = [stroke[2] + x, stroke[3] + y];
      drawStroke();
    } else if (event.buttons & 2 || event.shiftKey) moveBy(x, y);
    else turnBy(x * .008, y * .008);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  const underneath = (event) => {
    const box = canvas.getBoundingClientRect();
    return triangleAt(event.clientX - box.left, event.clientY - box.top);
  };
  const zoomTo = (t) => zoomToPart(t < 0 ? -1 : cut.part[t]);
  canvas.addEventListener('pointerup', (event) => {
    fingers.delete(event.pointerId);
    const drawn = moved < 6 ? null : stroke;
    stroke = null;
    drawStroke();
    if (drawn) return cutAlong(...drawn);
    if (moved < 6 && event.button === 0) {
      const t = underneath(event);
      act(t < 0 ? -1 : cut.part[t], t);
      // Not every browser makes a double click of two taps.
      if (event.pointerType !== 'touch' || mode !== 'view') return;
      const twice = event.timeStamp - tapped.time < 400 && Math.hypot(event.clientX - tapped.x, event.clientY - tapped.y) < 30;
      if (twice) zoomTo(t);
      tapped = { time: twice ? -Infinity : event.timeStamp, x: event.clientX, y: event.clientY };
    }
  });
  canvas.addEventListener('pointercancel', (event) => {
    fingers.delete(event.pointerId);
    stroke = null;
    drawStroke();
  });
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-event.deltaY * .0012));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turnBy(-.1, 0), ArrowRight: () => turnBy(.1, 0), ArrowUp: () => turnBy(0, -.1),
    ArrowDown: () => turnBy(0, .1), '+': () => zoomBy(1.15), '=': () => zoomBy(1.15), '-': () => zoomBy(1 / 1.15),
  };
  const anywhere = {
    r: reset, f: () => zoomToPart(), z: undo, y: redo, v: () => setMode('view'), m: () => setMode('merge'), s: () => setMode('split'),
    c: () => setMode('cut'), t: () => setMode('together'), a: () => setMode('apart'), d: () => setMode('drop'), p: () => setMode('protect'),
    Escape: () => { setMode('view'); showAll(); },
  };
  canvas.addEventListener('keydown', (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  document.addEventListener('keydown', (event) => {
    const typing = event.target.tagName === 'INPUT' && event.target.type === 'text';
    if (typing || event.altKey || ((event.ctrlKey || event.metaKey) && !'zy'.includes(event.key))) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (!anywhere[key]) return;
    event.preventDefault();
    anywhere[key]();
  });
  canvas.addEventListener('dblclick', (event) => zoomTo(underneath(event)));
  function reset() {
    view = start();
    draw();
  }
  $('all').onclick = showAll;
  $('reset').onclick = reset;
  $('landmarks').onchange = draw;
  $('lines').onchange = draw;
  $('slider').max = order.length - 1;
  $('slider').min = 0;
  $('slider').value = order.indexOf(found);
  $('slider').oninput = () => choose(order[$('slider').value]);
  if (order.length < 2) $('slider').hidden = true;
  new ResizeObserver(draw).observe(canvas);
  canvas.addEventListener('webglcontextlost', (event) => event.preventDefault());
  canvas.addEventListener('webglcontextrestored', () => location.reload());
  document.querySelectorAll('[data-mode]').forEach((button) => { button.onclick = () => setMode(button.dataset.mode); });
  document.querySelectorAll('[data-sort]').forEach((button) => { button.onclick = () => { sorting = button.dataset.sort; legend(); }; });
  $('undo').onclick = undo;
  $('redo').onclick = redo;
  $('zoom').onclick = () => zoomToPart();
  $('save-edits').onclick = () => save('edits.json', new Blob([text()], { type: 'application/json' }));
  $('save-labels').onclick = () => save(stem() + '.seg', new Blob([Array.from(cut.part).join('\n') + '\n'], { type: 'text/plain' }));
  $('save-picture').onclick = () => { drawNow(); canvas.toBlob((blob) => save(stem() + '.png', blob)); };
  $('copy').onclick = () => navigator.clipboard && navigator.clipboard.writeText(command());
  $('edit').hidden = !model;
  $('save-labels').disabled = !data.whole;
  $('thinned').hidden = data.whole;
  $('thinned').textContent = `The page shows ${counted(count, 'triangle')} for the ${counted(data.faces, 'face')} of the ` +
    'mesh, so it cannot save labels. Save the edits: the command below gives the labels of all faces.';
  if (earlier) $('slider').hidden = true;
  tell();
  choose(found);
  setMode('view');
  // What a test asks.
  window.page = {
    get parts() { return cut.colours.length; }, get alone() { return alone; }, get hidden() { return [...hidden]; },
    get visible() { return cut.part.reduce((sum, part) => sum + shown(part), 0); }, triangles: count, numbers: order, partAt,
    get mode() { return mode; }, get edits() { return JSON.parse(text()).edits; }, get names() { return [...cut.names]; },
    get zoom() { return view.zoom; }, get turn() { return view.turn.flat(); }, get over() { return over; }, get command() { return command(); },
    get colours() { return cut.colours; }, get status() { return $('status').textContent; }, get picked() { return picked; },
    get labels() { return Array.from(cut.part); }, get shares() { return measured; },
    get dropped() { return cut.dropped; }, get kept() { return [...cut.kept]; },
  };
})();
