// Boundaries moved from the edges of cells onto creases of the shown mesh, as src/cluster/boundary.rs does on all faces: what
// lies deep in a part keeps it, and a front that is held up where the surface turns decides between the parts on both sides.
function refiner(count, edges, corners, areas) {
  const BAND = 0.04, INTERIOR = 0.4, TURN = 5, CONVEX = 0.05;
  const unit = Math.sqrt(areas.reduce((sum, x) => sum + x, 0)) || 1;
  const centre = new Float32Array(3 * count), normal = new Float32Array(3 * count);
  for (let t = 0; t < count; t++) {
    for (let i = 0; i < 3; i++) {
      for (let k = 0; k < 3; k++) {
        centre[3 * t + k] += corners[18 * t + 6 * i + k] / 3 / unit;
        normal[3 * t + k] += corners[18 * t + 6 * i + 3 + k];
      }
    }
    const size = Math.hypot(...normal.subarray(3 * t, 3 * t + 3)) || 1;
    for (let k = 0; k < 3; k++) normal[3 * t + k] /= size;
  }
  // Neighbours of each triangle, with lengths and weights.
  const first = new Uint32Array(count + 1);
  for (const [, , s, t] of edges) { first[s + 1]++; first[t + 1]++; }
  for (let t = 0; t < count; t++) first[t + 1] += first[t];
  const near = new Uint32Array(first[count]), gaps = new Float32Array(first[count]), weights = new Float32Array(first[count]);
  const filled = first.slice();
  for (const [, , s, t] of edges) {
    let gap = 0, dot = 0, rise = 0;
    for (let k = 0; k < 3; k++) {
      const step = centre[3 * t + k] - centre[3 * s + k];
      gap += step * step;
      dot += normal[3 * s + k] * normal[3 * t + k];
      rise += (normal[3 * s + k] - normal[3 * t + k]) * step;
    }
    gap = Math.sqrt(gap);
    const weight = gap + TURN * Math.acos(Math.min(1, Math.max(-1, dot))) * (rise > 0 ? 1 : CONVEX);
    for (const [a, b] of [[s, t], [t, s]]) {
      near[filled[a]] = b;
      gaps[filled[a]] = gap;
      weights[filled[a]++] = weight;
    }
  }
  // Distances from `sources`, up to `limit`; `reach(from, to)` is told of each shorter way.
  function front(sources, field, lengths, limit, reach) {
    const queue = heap();
    sources.forEach((t) => queue.push(field[t], t));
    for (let top = queue.pop(); top; top = queue.pop()) {
      const [at, s] = top;
      if (at > field[s]) continue;
      for (let e = first[s]; e < first[s + 1]; e++) {
        const next = at + lengths[e], t = near[e];
        if (next < limit && next < field[t]) {
          field[t] = next;
          if (reach) reach(s, t);
          queue.push(field[t], t);
        }
      }
    }
  }
  const beside = (part, t) => {
    for (let e = first[t]; e < first[t + 1]; e++) if (part[near[e]] !== part[t]) return true;
    return false;
  };
  // How far each triangle lies from the boundaries of `part`, up to `limit`.
  function depths(part, limit) {
    const depth = new Float64Array(count).fill(Infinity), boundary = [];
    for (let t = 0; t < count; t++) if (beside(part, t)) { depth[t] = 0; boundary.push(t); }
    front(boundary, depth, gaps, limit);
    return depth;
  }
  function refine(part, parts) {
    const depth = depths(part, BAND), own = Array.from({ length: parts }, () => []);
    for (let t = 0; t < count; t++) own[part[t]].push(Math.min(depth[t], BAND));
    const limits = own.map((all) => {
      const sorted = Float64Array.from(all).sort();
      return sorted.length ? Math.min(BAND, sorted[Math.floor((1 - INTERIOR) * sorted.length)]) : 0;
    });
    const out = part.slice(), field = new Float64Array(count).fill(Infinity), sources = [];
    for (let t = 0; t < count; t++) if (Math.min(depth[t], BAND) >= limits[part[t]]) field[t] = 0;
    for (let t = 0; t < count; t++) {
      if (field[t] !== 0) continue;
      for (let e = first[t]; e < first[t + 1]; e++) if (field[near[e]] !== 0) { sources.push(t); break; }
    }
    front(sources, field, weights, Infinity, (s, t) => { out[t] = out[s]; });
    // A triangle between two of one other part belongs to it: teeth go.
    for (let round = 0; round < 4; round++) {
      for (let t = 0; t < count; t++) {
        if (!beside(out, t)) continue;
        const [a, b, c] = [first[t], first[t] + 1, first[t] + 2].map((e) => (e < first[t + 1] ? out[near[e]] : -1));
        const most = a === b || a === c ? a : b === c ? b : -1;
        if (most >= 0) out[t] = most;
      }
    }
    return out;
  }
  return { refine, depths };
}
