'use strict';
(() => {
  const data = JSON.parse(document.getElementById('data').textContent);
  const $ = (id) => document.getElementById(id);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const positions = new Uint16Array(bytes(data.positions));
  const triangles = new Uint32Array(bytes(data.triangles));
  const labels = new Uint16Array(bytes(data.labels));
  const count = labels.length;
  const report = data.report || {};

  // ---- geometry: corners of their own for every triangle, smooth normals
  const centre = data.extent.map((x) => x / 2);
  const place = (v, k) => positions[3 * v + k] / 65535 - centre[k];
  const normals = new Float32Array(positions.length);
  const areas = new Float32Array(count);
  for (let t = 0; t < count; t++) {
    const [a, b, c] = triangles.subarray(3 * t, 3 * t + 3);
    const u = [0, 1, 2].map((k) => place(b, k) - place(a, k));
    const w = [0, 1, 2].map((k) => place(c, k) - place(a, k));
    const n = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
    areas[t] = Math.hypot(...n) / 2;
    for (const v of [a, b, c]) for (let k = 0; k < 3; k++) normals[3 * v + k] += n[k];
  }
  const corner = new Float32Array(18 * count);
  for (let i = 0; i < 3 * count; i++) {
    const v = triangles[i];
    const length = Math.hypot(normals[3 * v], normals[3 * v + 1], normals[3 * v + 2]) || 1;
    for (let k = 0; k < 3; k++) {
      corner[6 * i + k] = place(v, k);
      corner[6 * i + 3 + k] = normals[3 * v + k] / length;
    }
  }
  // Edges between triangles, for boundaries and neighbours.
  const edges = [];
  {
    const open = new Map();
    const vertices = positions.length / 3;
    for (let t = 0; t < count; t++) {
      for (let k = 0; k < 3; k++) {
        const a = triangles[3 * t + k], b = triangles[3 * t + (k + 1) % 3];
        const key = Math.min(a, b) * vertices + Math.max(a, b);
        const other = open.get(key);
        if (other === undefined) open.set(key, t);
        else edges.push([a, b, other, t]);
      }
    }
  }

  // ---- cuts: the labels as found, and the tree's other numbers of parts
  const cells = data.cuts && new Uint16Array(bytes(data.cuts.cells));
  const tables = new Map();
  for (const text of data.cuts ? data.cuts.parts : []) {
    const table = new Uint16Array(bytes(text));
    const number = table.reduce((top, x) => Math.max(top, x), 0) + 1;
    if (!tables.has(number)) tables.set(number, table);
  }
  const found = data.colours.length;
  const palette = data.colours.concat([[230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178],
    [213, 94, 0], [204, 121, 167], [136, 34, 85], [17, 119, 51], [136, 204, 238], [221, 204, 119], [102, 102, 102]]);
  const cuts = new Map([[found, { part: labels, colours: data.colours }]]);
  const order = [...new Set([found, ...tables.keys()])].sort((a, b) => a - b);

  function cutInto(number) {
    if (!cuts.has(number)) {
      const table = tables.get(number);
      const part = new Uint16Array(count);
      for (let t = 0; t < count; t++) part[t] = table[cells[t]];
      cuts.set(number, { part, colours: colour(part, number) });
    }
    return cuts.get(number);
  }

  // A part keeps the colour of the part as found that it shares most area with; the rest take what neighbours leave.
  function colour(part, number) {
    const shared = Array.from({ length: number }, () => new Float64Array(found));
    for (let t = 0; t < count; t++) if (labels[t] < found) shared[part[t]][labels[t]] += areas[t];
    const near = Array.from({ length: number }, () => new Set());
    for (const [, , s, t] of edges) if (part[s] !== part[t]) { near[part[s]].add(part[t]); near[part[t]].add(part[s]); }
    const wish = [];
    shared.forEach((row, p) => row.forEach((area, q) => area > 0 && wish.push([area, p, q])));
    wish.sort((a, b) => b[0] - a[0]);
    const colours = new Array(number), taken = new Set();
    for (const [, p, q] of wish) if (!colours[p] && !taken.has(q)) { colours[p] = data.colours[q]; taken.add(q); }
    const same = (a, b) => a && b && a[0] === b[0] && a[1] === b[1] && a[2] === b[2];
    for (let p = 0; p < number; p++) {
      if (colours[p]) continue;
      const free = palette.find((c) => ![...near[p]].some((q) => same(colours[q], c)) && !colours.some((d) => same(c, d)));
      colours[p] = free || palette.find((c) => ![...near[p]].some((q) => same(colours[q], c))) || palette[p % palette.length];
    }
    return colours;
  }

  // ---- WebGL
  const canvas = $('view');
  const gl = canvas.getContext('webgl', { antialias: true, alpha: true });
  if (!gl) {
    $('hint').textContent = 'This browser does not offer WebGL.';
    return;
  }
  function program(vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return made;
  }
  const camera = 'uniform mat3 turn; uniform vec2 scale; uniform vec2 shift; uniform float lift;' +
    'vec4 seen(vec3 p) { vec3 q = turn * p; return vec4(q.xy * scale + shift, -q.z * .5 + lift, 1.); }';
  const surface = program(
    'attribute vec3 p; attribute vec3 n; attribute vec4 c; varying vec3 normal; varying vec4 tint;' + camera +
    'void main() { gl_Position = seen(p); normal = turn * n; tint = c; }',
    'precision mediump float; varying vec3 normal; varying vec4 tint; uniform bool plain;' +
    'void main() { if (tint.a < .5) discard; if (plain) { gl_FragColor = tint; return; }' +
    'vec3 n = normalize(normal); if (!gl_FrontFacing) n = -n;' +
    'float light = .42 + .5 * max(dot(n, normalize(vec3(-.4, .6, .7))), 0.) + .16 * max(dot(n, vec3(.7, -.2, .5)), 0.);' +
    'gl_FragColor = vec4(pow(pow(tint.rgb, vec3(2.2)) * light, vec3(1. / 2.2)), 1.); }');
  const points = program(
    'attribute vec3 p; uniform float size;' + camera + 'void main() { gl_Position = seen(p); gl_PointSize = size; }',
    'precision mediump float; uniform vec3 ink; uniform bool round;' +
    'void main() { if (round && length(gl_PointCoord - .5) > .5) discard; gl_FragColor = vec4(ink, 1.); }');
  const buffer = (content) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    if (content) gl.bufferData(gl.ARRAY_BUFFER, content, gl.STATIC_DRAW);
    return made;
  };
  const shape = buffer(corner);
  const tints = buffer();
  const lines = buffer();
  const marks = new Uint16Array(bytes(data.landmarks));
  const markAt = Float32Array.from(marks, (x, i) => x / 65535 - centre[i % 3]);
  const markers = buffer(markAt);
  let lineCount = 0;

  // ---- state
  const start = () => ({ turn: data.axes.map((axis) => axis.slice()), zoom: 1, shift: [0, 0] });
  let view = start();
  let cut = cutInto(found);
  let number = found;
  let alone = -1;
  let hidden = new Set();
  const shown = (part) => (alone < 0 || part === alone) && !hidden.has(part);

  const inColour = (part) => cut.colours[part] || [128, 128, 128];
  function paint(content) {
    const out = new Uint8Array(12 * count);
    for (let t = 0; t < count; t++) {
      const part = cut.part[t];
      if (!shown(part)) continue;
      const rgb = content(part);
      for (let k = 0; k < 3; k++) {
        out.set(rgb, 12 * t + 4 * k);
        out[12 * t + 4 * k + 3] = 255;
      }
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, tints);
    gl.bufferData(gl.ARRAY_BUFFER, out, gl.DYNAMIC_DRAW);
  }
  function outline() {
    const out = [];
    for (const [a, b, s, t] of edges) {
      if (cut.part[s] === cut.part[t] || !(shown(cut.part[s]) || shown(cut.part[t]))) continue;
      for (const v of [a, b]) for (let k = 0; k < 3; k++) out.push(place(v, k));
    }
    lineCount = out.length / 3;
    gl.bindBuffer(gl.ARRAY_BUFFER, lines);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(out), gl.DYNAMIC_DRAW);
  }
  function refresh() {
    paint(inColour);
    outline();
    legend();
    draw();
  }

  // ---- drawing
  function look(used, lift) {
    gl.useProgram(used);
    const at = (name) => gl.getUniformLocation(used, name);
    const turn = [0, 1, 2].flatMap((k) => view.turn.map((axis) => axis[k]));
    gl.uniformMatrix3fv(at('turn'), false, turn);
    const half = Math.hypot(...data.extent) / 2;
    const size = Math.min(canvas.width, canvas.height) * 1.2 / half * view.zoom;
    gl.uniform2f(at('scale'), size / canvas.width, size / canvas.height);
    gl.uniform2f(at('shift'), ...view.shift);
    gl.uniform1f(at('lift'), lift);
    return at;
  }
  function attribute(used, name, of, size, kind, stride, offset, scaled) {
    const at = gl.getAttribLocation(used, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, of);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, size, kind, scaled, stride, offset);
  }
  function drawSurface(flat) {
    const at = look(surface, 0);
    gl.uniform1i(at('plain'), flat);
    attribute(surface, 'p', shape, 3, gl.FLOAT, 24, 0, false);
    attribute(surface, 'n', shape, 3, gl.FLOAT, 24, 12, false);
    attribute(surface, 'c', tints, 4, gl.UNSIGNED_BYTE, 4, 0, true);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
  }
  function drawPoints(of, kind, many, ink, size, round) {
    for (let k = 0; k < 3; k++) gl.disableVertexAttribArray(k);
    const at = look(points, -.002);
    gl.uniform3f(at('ink'), ...ink);
    gl.uniform1f(at('size'), size);
    gl.uniform1i(at('round'), round);
    attribute(points, 'p', of, 3, gl.FLOAT, 12, 0, false);
    gl.drawArrays(kind, 0, many);
  }
  function clear() {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.max(1, Math.round(x * ratio)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }
  let waiting = false;
  function draw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      clear();
      drawSurface(false);
      if ($('lines').checked) drawPoints(lines, gl.LINES, lineCount, [.08, .08, .08], 1, false);
      if ($('landmarks').checked) {
        drawPoints(markers, gl.POINTS, markAt.length / 3, [1, 1, 1], 10 * (window.devicePixelRatio || 1), true);
        drawPoints(markers, gl.POINTS, markAt.length / 3, [.8, 0, .1], 7 * (window.devicePixelRatio || 1), true);
      }
    });
  }

  // The part under a point of the canvas, −1 for none: parts drawn as numbers, one pixel read.
  function partAt(x, y) {
    paint((part) => [part + 1 & 255, part + 1 >> 8, 0]);
    clear();
    drawSurface(true);
    const pixel = new Uint8Array(4);
    const ratio = canvas.width / canvas.clientWidth;
    gl.readPixels(Math.round(x * ratio), canvas.height - 1 - Math.round(y * ratio), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    paint(inColour);
    draw();
    return pixel[3] ? pixel[0] + 256 * pixel[1] - 1 : -1;
  }

  // ---- legend and report
  const group = (x) => Math.round(x).toLocaleString('en');
  const share = (x) => (100 * x).toFixed(x < .1 ? 2 : 1) + ' %';
  function legend() {
    const body = $('legend').tBodies[0];
    const area = new Float64Array(number), faces = new Float64Array(number);
    for (let t = 0; t < count; t++) { area[cut.part[t]] += areas[t]; faces[cut.part[t]] += 1; }
    const whole = area.reduce((a, b) => a + b, 0) || 1;
    const exact = number === found && Array.isArray(report.parts) && report.parts.length === found ? report.parts : null;
    const all = exact ? exact.reduce((sum, part) => sum + part.area, 0) || 1 : whole;
    body.replaceChildren(...cut.colours.map((rgb, part) => {
      const row = document.createElement('tr');
      row.dataset.part = part;
      row.tabIndex = 0;
      row.className = part === alone ? 'alone' : shown(part) ? '' : 'hidden';
      const cell = (text) => { const td = row.insertCell(); td.textContent = text; return td; };
      const swatch = document.createElement('span');
      swatch.className = 'swatch';
      swatch.style.background = `rgb(${rgb})`;
      cell('').append(swatch);
      cell(part);
      cell(exact ? group(exact[part].faces) : '≈ ' + group(faces[part] / count * data.faces));
      cell(share((exact ? exact[part].area : area[part]) / all));
      const button = document.createElement('button');
      button.textContent = hidden.has(part) ? 'show' : 'hide';
      button.onclick = (event) => { event.stopPropagation(); hide(part); };
      cell('').append(button);
      row.onclick = () => single(part);
      row.onkeydown = (event) => { if (event.key === 'Enter') single(part); };
      return row;
    }));
  }
  function single(part) {
    alone = alone === part || part < 0 ? -1 : part;
    hidden.delete(part);
    refresh();
  }
  function hide(part) {
    if (!hidden.delete(part)) hidden.add(part);
    if (alone === part) alone = -1;
    refresh();
  }
  function showAll() {
    alone = -1;
    hidden = new Set();
    refresh();
  }
  function choose(value) {
    number = value;
    cut = cutInto(number);
    $('count').textContent = number;
    $('which').textContent = number === found ? 'as found, boundaries refined' : 'from the merge tree, boundaries of cells';
    showAll();
  }
  function tell() {
    const input = report.input || {};
    $('facts').textContent = `${group(data.faces)} faces` + (count < data.faces ? `, shown with ${group(count)}` : '') +
      (input.components > 1 ? `, ${group(input.components)} components` : '');
    const box = $('report').querySelector('div');
    const table = (title, rows) => {
      const made = document.createElement('table');
      made.createCaption().textContent = title;
      for (const row of rows) { const line = made.insertRow(); line.insertCell(); row.forEach((x) => { line.insertCell().textContent = x; }); }
      box.append(made);
    };
    const seconds = Object.entries(report.seconds || {});
    if (seconds.length) table('Seconds a stage', seconds.map(([name, s]) => [name, Number(s).toFixed(3)]));
    const sizes = Object.entries(report.bytes || {}).filter(([, x]) => typeof x === 'number');
    if (sizes.length) table('Bytes', sizes.map(([name, x]) => [name.replaceAll('_', ' '), group(x)]));
    const values = (report.eigenvalues || []).filter((x) => x > 0);
    if (values.length) {
      const top = values[0], bars = values.slice(0, 60), width = 100 / bars.length;
      const title = document.createElement('p');
      title.textContent = `Eigenvalues, the greatest ${bars.length} (λ₁ = ${top.toPrecision(4)})`;
      const holder = document.createElement('div');
      holder.innerHTML = '<svg viewBox="0 0 100 30" preserveAspectRatio="none">' + bars.map((x, k) =>
        `<rect x="${k * width}" y="${30 - 30 * x / top}" width="${width * .8}" height="${30 * x / top}" fill="#0072b2"/>`).join('') + '</svg>';
      box.append(title, holder);
    }
    if (!box.childElementCount) $('report').hidden = true;
    if (!markAt.length) $('landmarks').parentElement.hidden = true;
  }

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
  let moved = 0;
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener('pointermove', (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const [x, y] = [event.clientX - before[0], event.clientY - before[1]];
    moved += Math.abs(x) + Math.abs(y);
    const other = [...fingers.entries()].find(([id]) => id !== event.pointerId);
    if (other) {
      const span = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
      zoomBy(span([event.clientX, event.clientY]) / span(before));
      moveBy(x / 2, y / 2);
    } else if (event.buttons & 2 || event.shiftKey) moveBy(x, y);
    else turnBy(x * .008, y * .008);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener('pointerup', (event) => {
    fingers.delete(event.pointerId);
    if (moved < 6 && event.button === 0) {
      const box = canvas.getBoundingClientRect();
      single(partAt(event.clientX - box.left, event.clientY - box.top));
    }
  });
  canvas.addEventListener('pointercancel', (event) => fingers.delete(event.pointerId));
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-event.deltaY * .0012));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turnBy(-.1, 0), ArrowRight: () => turnBy(.1, 0), ArrowUp: () => turnBy(0, -.1),
    ArrowDown: () => turnBy(0, .1), '+': () => zoomBy(1.15), '=': () => zoomBy(1.15), '-': () => zoomBy(1 / 1.15),
    r: reset, R: reset, Escape: showAll,
  };
  canvas.addEventListener('keydown', (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
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
  tell();
  choose(found);
  // What a test asks.
  window.page = {
    get parts() { return number; }, get alone() { return alone; }, get hidden() { return [...hidden]; },
    get visible() { return cut.part.reduce((sum, part) => sum + shown(part), 0); }, triangles: count, numbers: order, partAt,
  };
})();
