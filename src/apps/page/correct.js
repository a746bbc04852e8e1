  // ---- correcting
  const HINTS = {
    view: 'click a part to see it alone, double-click to zoom to it', merge: 'click two parts to merge them',
    split: 'click a part to divide it along the hierarchy', cut: 'draw a line across a part, or click a place on either side of the cut',
    together: 'click two places that belong to one part', apart: 'click two places that belong to different parts',
    drop: 'click a part that is not wanted', protect: 'click a part that no later edit may change',
  };
  function say(told) { $('status').textContent = told; }
  function setMode(wanted) {
    const late = earlier && hint(wanted);
    mode = model && !late ? wanted : 'view';
    picked = null;
    document.querySelectorAll('[data-mode]').forEach((button) => button.setAttribute('aria-pressed', button.dataset.mode === mode));
    say(late ? 'Hints are applied before edits, and these parts have edits already: give hints on the page without edits.' : HINTS[mode]);
    refresh();
  }
  const hint = (edit) => edit === 'together' || edit === 'apart';
  // What a click on a part does; `t` is the triangle, −1 in the list.
  function act(part, t) {
    if (mode === 'view') return single(part);
    if (part < 0) return say(HINTS[mode]);
    if (mode === 'split') return change({ edit: 'split', at: [anchor(part)], into: Math.max(2, Math.round(Number($('into').value)) || 2) });
    if (mode === 'drop' || mode === 'protect') return change({ edit: mode, at: [anchor(part)] });
    if (mode === 'cut' && t < 0) return say('Click the two places on the mesh itself.');
    if (!picked) {
      picked = { part, triangle: t };
      say({ merge: `Now click the part to merge with ${nameOf(part)}.`, cut: 'Now click a place on the other side of the cut.',
        together: 'Now click a place that belongs to the same part.', apart: 'Now click a place that belongs to another part.' }[mode]);
      return refresh();
    }
    const first = picked;
    picked = null;
    if (mode === 'cut') return change({ edit: 'cut', at: [first.triangle, t] });
    if (hint(mode)) return hintAt(first, { part, triangle: t });
    if (first.part === part) { say(HINTS.merge); return refresh(); }
    change({ edit: 'merge', at: [anchor(first.part), anchor(part)] });
  }
  // A hint about two places. It comes before other edits, which may hide what it does.
  function hintAt(...places) {
    const at = places.map(({ part, triangle }) => (triangle < 0 ? anchor(part) : triangle)), edit = mode, before = edits.length;
    const holds = () => {
      const { label } = followed(edits);
      return (label[cellAt(at[0])] === label[cellAt(at[1])]) === (edit === 'together');
    };
    const held = holds();
    change({ edit, at });
    if (edits.length === before) return;
    if (!holds()) say('Hints are applied first, and a later edit reverses this one: undo that edit.');
    else if (held) say('This is so already; the hint is kept.');
  }
  // A cut where a line is drawn on the canvas: between two places on one part, on either side of it.
  function cutAlong(x1, y1, x2, y2) {
    picked = null;
    const length = Math.hypot(x2 - x1, y2 - y1) || 1, [u, w] = [(y1 - y2) / length, (x2 - x1) / length];
    for (const along of [.5, .4, .6, .3, .7]) {
      const [x, y] = [x1 + along * (x2 - x1), y1 + along * (y2 - y1)], on = partAt(x, y);
      for (const gap of [.3, .2, .12, .45, .06].map((share) => Math.max(6, share * length))) {
        const at = [triangleAt(x + gap * u, y + gap * w), triangleAt(x - gap * u, y - gap * w)];
        if (on < 0 || !at.every((t) => t >= 0 && cut.part[t] === on)) continue;
        if (cellAt(at[0]) !== cellAt(at[1])) return change({ edit: 'cut', at });
      }
    }
    say('Draw the line across one part.');
    refresh();
  }
  // The triangle of a part that lies deepest in it: a place that stays on the part on other versions of the mesh.
  function anchor(part) {
    const depth = refined.depths(cut.part, Infinity);
    let best = -1;
    for (let t = 0; t < count; t++) if (cut.part[t] === part && (best < 0 || depth[t] > depth[best])) best = t;
    return best;
  }
  // The cell that stands for a triangle: its own, or beside a boundary the nearest one of the part that is seen there before edits.
  let before = { number: -1 };
  function cellAt(t) {
    const base = baseOf(number);
    if (before.number !== number) {
      const rough = Uint16Array.from({ length: count }, (_, s) => base[cells[s]]);
      before = { number, part: number === found ? labels : refined.refine(rough, number) };
    }
    return model.nearest(base, cells[t], before.part[t]);
  }
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  function change(edit) {
    const made = { ...edit, cells: edit.at.map(cellAt) };
    if (edit.edit === 'colour') [made.colour, made.hex] = [rgb(edit.colour), edit.colour];
    if (made.edit === 'protect') made.from = number;
    const elsewhere = made.edit === 'protect' && protectedAt() !== number;
    const error = elsewhere ? `Parts are protected in the cut into ${protectedAt()}: go back to it.` : followed([...edits, made]).error;
    if (error) { say(error); return refresh(); }
    edits.push(made);
    undone = [];
    say(`${counted(edits.length, 'edit')}: ${edit.edit}`);
    alone = -1;
    hidden = new Set();
    update();
    refresh();
  }
  function undo() {
    if (!edits.length) return;
    undone.push(edits.pop());
    say('undone: ' + undone[undone.length - 1].edit);
    update();
    showAll();
  }
  function redo() {
    if (!undone.length) return;
    edits.push(undone.pop());
    say('redone: ' + edits[edits.length - 1].edit);
    update();
    showAll();
  }
  const point = (t) => Array.from(middle(t), (x, k) => data.low[k] + (x + centre[k]) * data.side);
  function text() {
    const own = edits.map(({ edit, at, into, name, hex }) => {
      const places = at.map(point);
      if (edit === 'merge' || hint(edit)) return { edit, at: places };
      if (edit === 'cut') return { edit, between: places };
      if (edit === 'split') return { edit, at: places[0], into };
      if (edit === 'name') return { edit, at: places[0], name };
      return edit === 'colour' ? { edit, at: places[0], colour: hex } : { edit, at: places[0] };
    });
    const all = { format: 'nystrom-stream edits', version: 1, mesh: data.title, ...from() };
    all.box = [data.low, data.low.map((x, k) => x + data.extent[k] * data.side)];
    all.edits = [...(earlier ? earlier.edits : []), ...own];
    const lines = all.edits.map((edit) => '    ' + JSON.stringify(edit));
    const head = JSON.stringify({ ...all, edits: undefined }, null, 2).slice(0, -2);
    return `${head},\n  "edits": [${lines.length ? '\n' + lines.join(',\n') + '\n  ' : ''}]\n}\n`;
  }
  // The cut that edits start from.
  function from() {
    const at = protectedAt();
    if (at !== found) return { parts: at };
    if (earlier) return earlier.parts ? { parts: earlier.parts } : earlier.detail ? { detail: earlier.detail } : {};
    const asked = ((report.options || {}).parts || {});
    if (asked.count && asked.count.exactly) return { parts: asked.count.exactly };
    if (asked.count && asked.count.between) return { parts: found };
    return asked.detail || at !== number ? { detail: asked.detail || 0 } : {};
  }
  const stem = () => data.title.replace(/\.[^.]*$/, '');
  const quoted = (word) => (/^[\w./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
  // Options that the same cells and parts come from.
  function options() {
    const all = report.options || {}, method = all.cluster || 'parts';
    const cluster = method === 'parts' ? '' : ` --cluster ${method.replace('k-means', 'kmeans')}`;
    return cluster + (all.seed ? ` --seed ${all.seed}` : '') + (all.exact ? ' --exact' : '') + (all.landmarks ? ` -l ${all.landmarks}` : '');
  }
  // The option for the number of parts beside saved edits. Without it their file says which cut they start from; if they
  // protect parts of that cut, the rest may be cut into another number, and a file holds no bounds.
  function beside() {
    if (protectedAt() !== number && number !== found) return ` -k ${number}`;
    const { count, detail } = (report.options || {}).parts || {};
    if (!count) return '';
    const range = count.between ? ` --parts-range ${count.between.join('..')}` : '', finer = range && !detail ? '' : ` --detail ${detail || 0}`;
    const asked = count.exactly ? ` -k ${count.exactly}` : range + finer;
    if (protectedAt() !== number) return asked;
    const own = !earlier ? asked : earlier.parts ? ` -k ${earlier.parts}` : ` --detail ${earlier.detail || 0}`;
    return own === asked ? '' : asked;
  }
  function command() {
    const mesh = data.title.startsWith('<') ? 'MESH' : quoted(data.title);
    const all = from(), start = `nystrom-stream segment ${mesh}${options()}`;
    if (edits.length || earlier) return `${start} --edits edits.json${beside()} -o ${quoted(stem() + '.corrected.ply')}`;
    return start + (all.parts ? ` -k ${all.parts}` : all.detail ? ` --detail ${all.detail}` : '');
  }
  function save(name, blob) {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }
  // The name of the part under the pointer.
  let hovering = null;
  function hover(event) {
    if (event.pointerType === 'touch') return;
    const asked = hovering;
    hovering = event;
    if (asked) return;
    requestAnimationFrame(() => {
      const box = canvas.getBoundingClientRect(), [x, y] = [hovering.clientX - box.left, hovering.clientY - box.top];
      hovering = null;
      over = partAt(x, y);
      const tip = $('tip');
      tip.hidden = over < 0;
      if (over < 0) return;
      tip.textContent = `${nameOf(over)} · ${share(measured[over])}`;
      tip.style.transform = `translate(${x + 14}px, ${y + 14}px)`;
    });
  }
  canvas.addEventListener('pointerleave', () => { over = -1; $('tip').hidden = true; });
  // Fills the view with a part: the one that is looked at, else the one under the pointer.
  function zoomToPart(part = alone >= 0 ? alone : over) {
    if (part < 0) return say('Choose a part first.');
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (let t = 0; t < count; t++) {
      if (cut.part[t] !== part) continue;
      const p = middle(t);
      for (let k = 0; k < 2; k++) {
        const q = view.turn[k][0] * p[0] + view.turn[k][1] * p[1] + view.turn[k][2] * p[2];
        [low[k], high[k]] = [Math.min(low[k], q), Math.max(high[k], q)];
      }
    }
    const half = Math.hypot(...data.extent) / 2;
    view.zoom = Math.min(60, Math.max(.2, .7 * half / Math.max(1e-6, (high[0] - low[0]) / 2, (high[1] - low[1]) / 2)));
    const size = Math.min(canvas.width, canvas.height) * 1.2 / half * view.zoom;
    view.shift = [0, 1].map((k) => -(low[k] + high[k]) / 2 * size / [canvas.width, canvas.height][k]);
    draw();
  }

