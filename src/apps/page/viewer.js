// Draws the parts, and lets a person look at them and correct them.
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
        if (a === b) continue;
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
  const order = [...new Set([found, ...tables.keys()])].sort((a, b) => a - b);

  // ---- edits: those that the page came with, and those made on it
  const earlier = data.edits && data.edits.edits.length ? data.edits : null;
  const hexOf = (rgb) => '#' + rgb.map((x) => x.toString(16).padStart(2, '0')).join('');
  const given = new Set((earlier ? earlier.edits : []).map(({ colour }) => colour));
  const numbered = (list) => (earlier && list ? list : []).map((said, part) => [part, said])
    .filter(([part]) => !data.dropped.includes(part));
  const marked = {
    dropped: data.dropped, kept: data.kept, names: numbered(data.names).filter(([, name]) => name),
    colours: numbered(data.colours).filter(([, rgb]) => given.has(hexOf(rgb))),
  };
  const model = data.cuts && data.cuts.model ? editorOf(data.cuts.model, bytes, marked) : null;
  const refined = refiner(count, edges, corner, areas);
  let edits = [], undone = [];

  // The cells with `list` followed at this position of the slider. Protected parts stay as they are at the position where the first
  // was protected.
  const baseOf = (at) => (at === found ? (model ? model.start : null) : tables.get(at));
  const protectedAt = () => (edits.find(({ edit }) => edit === 'protect') || { from: number }).from;
  const followed = (list) => (protectedAt() === number ? model.follow(baseOf(number), list) : model.around(baseOf(protectedAt()), number, list));

  // The cut into `number` parts with the edits so far. `id` is the number by which edits know a part.
  function cutInto(number) {
    const plain = number === found && protectedAt() === number && edits.every(({ edit }) => ['name', 'colour', 'protect'].includes(edit));
    const base = baseOf(number), own = number === found && protectedAt() === number;
    const none = { label: base, names: new Map(), colours: new Map(), dropped: new Set(), kept: new Set() };
    const state = model ? followed(edits) : none;
    if (plain) {
      const names = new Map((data.names || []).map((name, part) => [part, name]));
      state.names.forEach((name, part) => names.set(part, name));
      names.forEach((name, part) => name || names.delete(part));
      const colours = data.colours.map((rgb, part) => state.colours.get(part) || rgb);
      const dropped = data.dropped.length ? data.dropped[0] : -1;
      return { part: labels, colours, names, id: colours.map((_, part) => part), dropped, kept: state.kept, plain };
    }
    const ids = [...new Set(Array.from(state.label).filter((id) => !state.dropped.has(id)))];
    const place = new Map(ids.map((id, part) => [id, part]));
    const dropped = state.dropped.size ? ids.length : -1;
    for (const id of state.dropped) place.set(id, ids.length);
    if (dropped >= 0) ids.push([...state.dropped][0]);
    const rough = new Uint16Array(count);
    for (let t = 0; t < count; t++) rough[t] = place.get(state.label[cells[t]]);
    let part = refined.refine(rough, ids.length);
    if (number === found || protectedAt() === found) part = keepFound(part, rough, baseOf(found), state.label, place);
    const names = new Map(own ? (data.names || []).map((name, id) => [id, name]).filter(([, name]) => name) : []);
    state.names.forEach((name, id) => names.set(id, name));
    const named = new Map(ids.map((id, k) => [k, k === dropped ? 'dropped' : names.get(id)]).filter(([, name]) => name));
    const colours = colour(part, ids.length);
    ids.forEach((id, k) => { if (state.colours.has(id)) colours[k] = state.colours.get(id); });
    if (dropped >= 0) colours[dropped] = [128, 128, 128];
    const kept = new Set([...state.kept].map((id) => place.get(id)));
    return { part, colours, names: named, id: ids, dropped, kept, error: state.error };
  }
  // What neither edits nor the number have divided keeps the boundaries that the program has refined on all faces.
  function keepFound(part, rough, base, label, place) {
    const into = new Map();
    base.forEach((old, cell) => {
      if (!into.has(old)) into.set(old, new Set());
      into.get(old).add(place.get(label[cell]));
    });
    // The cell of some triangles along boundaries is of another part as found: they take what is beside them.
    const open = new Set();
    const kept = part.map((now, t) => {
      const own = into.get(labels[t]);
      if (!own || own.has(now)) return own && own.size === 1 ? [...own][0] : now;
      if (own.size > 1 && !own.has(rough[t])) open.add(t);
      return own.has(rough[t]) ? rough[t] : [...own][0];
    });
    for (let left = -1; left !== open.size;) {
      left = open.size;
      for (const [, , s, t] of edges) {
        for (const [a, b] of [[s, t], [t, s]]) {
          if (open.has(a) && !open.has(b) && labels[a] === labels[b]) { kept[a] = kept[b]; open.delete(a); }
        }
      }
    }
    return kept;
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
    $('hint').textContent = 'This browser does not support WebGL.';
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
    'precision mediump float; varying vec3 normal; varying vec4 tint; uniform bool ghost;' +
    'void main() { if (tint.a < .05 || ghost == (tint.a > .9)) discard;' +
    'vec3 n = normalize(normal); if (!gl_FrontFacing) n = -n;' +
    'float light = .42 + .5 * max(dot(n, normalize(vec3(-.4, .6, .7))), 0.) + .16 * max(dot(n, vec3(.7, -.2, .5)), 0.);' +
    'gl_FragColor = vec4(pow(pow(tint.rgb, vec3(2.2)) * light, vec3(1. / 2.2)), 1.) * (ghost ? .13 : 1.); }');
  const picking = program(
    'attribute vec3 p; attribute vec4 c; attribute vec3 id; varying vec4 tint;' + camera +
    'void main() { gl_Position = seen(p); tint = vec4(id, c.a); }',
    'precision mediump float; varying vec4 tint; void main() { if (tint.a < .9) discard; gl_FragColor = vec4(tint.rgb, 1.); }');
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
  const numbersOf = new Uint8Array(12 * count);
  for (let i = 0; i < 3 * count; i++) {
    const t = Math.floor(i / 3) + 1;
    numbersOf.set([t & 255, (t >> 8) & 255, t >> 16, 255], 4 * i);
  }
  const identities = buffer(numbersOf);
  const target = { frame: gl.createFramebuffer(), colour: gl.createTexture(), depth: gl.createRenderbuffer(), width: 0, stale: true };
  const lines = buffer();
  const marks = new Uint16Array(bytes(data.landmarks));
  const markAt = Float32Array.from(marks, (x, i) => x / 65535 - centre[i % 3]);
  const markers = buffer(markAt);
  let lineCount = 0;
  const spot = buffer();
  const middle = (t) => Float32Array.from([0, 1, 2], (k) => (corner[18 * t + k] + corner[18 * t + 6 + k] + corner[18 * t + 12 + k]) / 3);

  // ---- state
  const start = () => ({ turn: data.axes.map((axis) => axis.slice()), zoom: 1, shift: [0, 0] });
  let view = start();
  let number = found;
  let cut = cutInto(found);
  let alone = -1;
  let hidden = new Set();
  let mode = 'view', picked = null, over = -1;
  const shown = (part) => (alone < 0 || part === alone) && !hidden.has(part);

  const GHOST = 60;
  function paint() {
    const out = new Uint8Array(12 * count);
    const held = picked && mode === 'merge' ? picked.part : -1;
    const tint = cut.colours.map((rgb, part) => {
      const bright = part === held ? rgb.map((x) => Math.round(x + 0.55 * (255 - x))) : rgb;
      return [...bright, shown(part) ? 255 : alone >= 0 && !hidden.has(part) ? GHOST : 0];
    });
    for (let t = 0; t < count; t++) {
      const of = tint[cut.part[t]] || [128, 128, 128, 255];
      for (let k = 0; k < 3; k++) out.set(of, 12 * t + 4 * k);
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
    paint();
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
  function drawSurface(used) {
    const at = look(used, 0);
    attribute(used, 'p', shape, 3, gl.FLOAT, 24, 0, false);
    attribute(used, 'c', tints, 4, gl.UNSIGNED_BYTE, 4, 0, true);
    if (used === picking) attribute(used, 'id', identities, 3, gl.UNSIGNED_BYTE, 4, 0, true);
    else {
      attribute(used, 'n', shape, 3, gl.FLOAT, 24, 12, false);
      gl.uniform1i(at('ghost'), false);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
    if (used === picking || alone < 0) return;
    gl.uniform1i(at('ghost'), true);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
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
    target.stale = true;
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; drawNow(); });
  }
  function drawNow() {
      clear();
      drawSurface(surface);
      if ($('lines').checked) drawPoints(lines, gl.LINES, lineCount, [.08, .08, .08], 1, false);
      if ($('landmarks').checked) {
        drawPoints(markers, gl.POINTS, markAt.length / 3, [1, 1, 1], 10 * (window.devicePixelRatio || 1), true);
        drawPoints(markers, gl.POINTS, markAt.length / 3, [.8, 0, .1], 7 * (window.devicePixelRatio || 1), true);
      }
      if (picked && picked.triangle >= 0 && mode !== 'merge') {
        gl.bindBuffer(gl.ARRAY_BUFFER, spot);
        gl.bufferData(gl.ARRAY_BUFFER, middle(picked.triangle), gl.DYNAMIC_DRAW);
        drawPoints(spot, gl.POINTS, 1, [1, 1, 1], 14 * (window.devicePixelRatio || 1), true);
        drawPoints(spot, gl.POINTS, 1, [0, 0, 0], 9 * (window.devicePixelRatio || 1), true);
      }
  }

  // The triangle under a point of the canvas, −1 for none: triangles are drawn as numbers out of sight, one pixel is read.
  function triangleAt(x, y) {
    if (target.stale) {
      clear();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
      if (target.width !== canvas.width || target.height !== canvas.height) {
        [target.width, target.height] = [canvas.width, canvas.height];
        gl.bindTexture(gl.TEXTURE_2D, target.colour);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, target.width, target.height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.colour, 0);
        gl.bindRenderbuffer(gl.RENDERBUFFER, target.depth);
        gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT16, target.width, target.height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, target.depth);
      }
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      for (let k = 0; k < 3; k++) gl.disableVertexAttribArray(k);
      drawSurface(picking);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      drawNow();
      target.stale = false;
    }
    const pixel = new Uint8Array(4), ratio = canvas.width / canvas.clientWidth;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.readPixels(Math.round(x * ratio), canvas.height - 1 - Math.round(y * ratio), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return pixel[3] ? pixel[0] + 256 * pixel[1] + 65536 * pixel[2] - 1 : -1;
  }
  const partAt = (x, y) => {
    const t = triangleAt(x, y);
    return t < 0 ? -1 : cut.part[t];
  };

  // ---- legend and report
  const group = (x) => Math.round(x).toLocaleString('en');
  const counted = (n, what) => `${group(n)} ${what}${n === 1 ? '' : 's'}`;
  const share = (x) => (100 * x).toFixed(x < .1 ? 2 : 1) + ' %';
  const nameOf = (part) => cut.names.get(part) || `part ${part}`;
  let measured = [], sorting = 'part';
  function legend() {
    const body = $('legend').tBodies[0];
    const area = new Float64Array(cut.colours.length), faces = new Float64Array(cut.colours.length);
    for (let t = 0; t < count; t++) { area[cut.part[t]] += areas[t]; faces[cut.part[t]] += 1; }
    const whole = area.reduce((a, b) => a + b, 0) || 1;
    const exact = cut.plain && Array.isArray(report.parts) && report.parts.length === found ? report.parts : null;
    // The report of a cut from the hierarchy has no areas; those of very large or small meshes are null or 0.
    const sum = exact && exact.every((part) => Number.isFinite(part.area)) ? exact.reduce((sum, part) => sum + part.area, 0) : 0;
    measured = Array.from(area, (x, part) => (sum > 0 ? exact[part].area / sum : x / whole));
    const rows = cut.colours.map((_, part) => part);
    if (sorting === 'area') rows.sort((a, b) => measured[b] - measured[a] || a - b);
    if (sorting === 'name') rows.sort((a, b) => nameOf(a).localeCompare(nameOf(b), 'en', { numeric: true }));
    document.querySelectorAll('#legend th button').forEach((button) => button.setAttribute('aria-pressed', button.dataset.sort === sorting));
    // The keyboard stays where it is in the list.
    const held = body.contains(document.activeElement) && document.activeElement, line = held && held.closest('tr');
    const at = line && ['tr', 'input[type=color]', 'input[type=text]', 'button'].find((kind) => held.matches(kind));
    body.replaceChildren(...rows.map((part) => {
      const row = document.createElement('tr');
      row.dataset.part = part;
      row.tabIndex = 0;
      row.className = part === alone ? 'alone' : shown(part) ? '' : 'hidden';
      if (picked && (mode === 'merge' || picked.triangle < 0) && picked.part === part) row.classList.add('picked');
      const cell = (text) => { const td = row.insertCell(); td.textContent = text; return td; };
      const swatch = input(model && part !== cut.dropped ? 'color' : 'swatch', hexOf(cut.colours[part] || [128, 128, 128]), `colour of ${nameOf(part)}`);
      // Later: the keyboard goes on to what is next in the list first.
      swatch.onchange = () => setTimeout(change, 0, { edit: 'colour', at: [anchor(part)], colour: swatch.value });
      cell('').append(swatch);
      cell(part);
      const name = input(model && part !== cut.dropped ? 'text' : 'plain', cut.names.get(part) || '', `name of part ${part}`);
      name.onchange = () => setTimeout(change, 0, { edit: 'name', at: [anchor(part)], name: name.value.replace(/\p{Cc}+/gu, ' ').trim() });
      cell('').append(name);
      cell(exact ? group(exact[part].faces) : '≈ ' + group(faces[part] / count * data.faces));
      cell(share(measured[part]));
      const button = document.createElement('button');
      button.textContent = hidden.has(part) ? 'show' : 'hide';
      button.onclick = (event) => { event.stopPropagation(); hide(part); };
      cell('').append(button);
      row.onclick = () => act(part, -1);
      row.onkeydown = (event) => { if (event.key === 'Enter' && event.target === row) act(part, -1); };
      return row;
    }));
    if (!line) return;
    const row = [...body.rows].find((other) => other.dataset.part === line.dataset.part) || body.rows[body.rows.length - 1];
    (at === 'tr' ? row : row.querySelector(at) || row).focus();
  }
  function input(kind, value, told) {
    const made = document.createElement(kind === 'plain' || kind === 'swatch' ? 'span' : 'input');
    if (kind === 'plain') made.textContent = value;
    else if (kind === 'swatch') { made.className = 'swatch'; made.style.background = value; }
    else {
      [made.type, made.value, made.maxLength] = [kind, value, 60];
      made.setAttribute('aria-label', told);
      made.onclick = (event) => event.stopPropagation();
      if (kind === 'text') made.placeholder = told.replace('name of ', '');
    }
    return made;
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
    picked = null;
    refresh();
  }
  function choose(value) {
    number = value;
    update();
    showAll();
  }
  function update() {
    cut = cutInto(number);
    if (cut.error) say(cut.error);
    $('count').textContent = cut.colours.length;
    $('which').textContent = cut.plain ? 'as found, boundaries refined on all faces' : 'boundaries refined on the shown mesh';
    const held = document.activeElement;
    $('undo').disabled = !edits.length;
    $('redo').disabled = !undone.length;
    // A disabled button hears no key.
    if (held && held.disabled) $(held.id === 'undo' ? 'redo' : 'undo').focus();
    $('slider').setAttribute('aria-valuetext', counted(cut.colours.length, 'part'));
    $('command').textContent = command();
  }
  function tell() {
    const input = report.input || {};
    $('facts').textContent = counted(data.faces, 'face') + (count < data.faces ? `, shown with ${group(count)}` : '') +
      (input.components > 1 ? `, ${counted(input.components, 'component')}` : '');
    const box = $('report').querySelector('div');
    const values = (report.eigenvalues || []).filter((x) => x > 0);
    if (values.length) {
      const top = values[0], bars = values.slice(0, 60), width = 100 / bars.length;
      const title = document.createElement('p');
      title.textContent = `The ${bars.length > 1 ? `${bars.length} greatest eigenvalues` : 'greatest eigenvalue'} (λ₁ = ${top.toPrecision(4)})`;
      const holder = document.createElement('div');
      holder.innerHTML = '<svg viewBox="0 0 100 30" preserveAspectRatio="none">' + bars.map((x, k) =>
        `<rect x="${k * width}" y="${30 - 30 * x / top}" width="${width * .8}" height="${30 * x / top}" fill="#0072b2"/>`).join('') + '</svg>';
      box.append(title, holder);
    }
    if (!box.childElementCount) $('report').hidden = true;
    if (!markAt.length) $('landmarks').parentElement.hidden = true;
  }

