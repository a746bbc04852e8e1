'use strict';
// Parts while edits are followed, on the cells of the surface: the steps of src/pipeline/edits.rs, src/cluster/parts/hints.rs
// and src/cluster/parts/split.rs, so that a page shows what the program will make of the same edits. `marked` are the
// names, colours, dropped and protected parts that `start` has from earlier edits.
function editorOf(model, bytes, marked) {
  const numbers = (text) => new Uint16Array(bytes(text));
  const start = numbers(model.start), unions = numbers(model.unions), pairs = numbers(model.pairs);
  const area = new Float32Array(bytes(model.area)), length = new Float32Array(bytes(model.length));
  const steps = new Float32Array(bytes(model.steps)), superfaces = numbers(model.superfaces);
  const together = numbers(model.together);
  const n = start.length, m = pairs.length / 2;
  const R = superfaces.reduce((top, x) => Math.max(top, x), 0) + 1;
  const C = (x, y) => {
    if (x === y) return 1;
    const [i, j] = x < y ? [x, y] : [y, x];
    return together[i * (2 * R - i - 1) / 2 + j - i - 1] / 65535;
  };

  // ---- labellings
  function compact(label) {
    const number = new Map();
    const out = Array.from(label, (x) => {
      if (!number.has(x)) number.set(x, number.size);
      return number.get(x);
    });
    return [out, number.size];
  }
  function forest(size) {
    const name = Int32Array.from({ length: size }, (_, i) => i);
    const find = (i) => {
      while (name[i] !== i) i = name[i] = name[name[i]];
      return i;
    };
    const join = (i, j) => {
      const [a, b] = [find(i), find(j)];
      name[Math.max(a, b)] = Math.min(a, b);
    };
    const copy = () => {
      const other = forest(size);
      name.forEach((up, i) => other.join(i, up));
      return other;
    };
    return { find, join, copy };
  }
  function pieces(graph, label) {
    const sets = forest(label.length);
    graph.pairs.forEach(([i, j]) => label[i] === label[j] && sets.join(i, j));
    return compact(label.map((_, i) => sets.find(i)));
  }
  function sums(label, value, count) {
    const out = new Float64Array(count);
    label.forEach((k, i) => { out[k] += value[i]; });
    return out;
  }
  function joinSmall(graph, label, limit, lowest) {
    const count = Math.max(-1, ...label) + 1;
    const size = sums(label, graph.area, count);
    const open = Array.from(size, (x, k) => k >= lowest && x > 0 && x < limit);
    const into = Array.from(size, (_, k) => k);
    const now = label.slice();
    while (open.includes(true)) {
      let q = -1;
      open.forEach((is, k) => { if (is && (q < 0 || size[k] < size[q])) q = k; });
      open[q] = false;
      const shared = new Float64Array(count);
      graph.pairs.forEach(([i, j], e) => {
        if (now[i] === q && now[j] !== q) shared[now[j]] += graph.length[e];
        else if (now[j] === q && now[i] !== q) shared[now[i]] += graph.length[e];
      });
      let to = -1;
      shared.forEach((x, k) => { if (x > 0 && (to < 0 || x > shared[to])) to = k; });
      if (to < 0) continue;
      size[to] += size[q];
      open[to] = open[to] && size[to] < limit;
      into.forEach((k, i) => { if (k === q) into[i] = to; });
      now.forEach((k, i) => { if (k === q) now[i] = to; });
    }
    return compact(label.map((k) => into[k]));
  }
  function smallParts(graph, raw, limit, whole) {
    const [label, parts] = compact(raw);
    const [piece, count] = pieces(graph, label);
    const size = sums(piece, graph.area, count);
    const part = new Array(count), largest = new Array(parts).fill(-1);
    piece.forEach((p, i) => { part[p] = label[i]; });
    part.forEach((k, p) => { if (largest[k] < 0 || size[p] > size[largest[k]]) largest[k] = p; });
    const loose = part.map((k, p) => size[p] < limit && largest[k] !== p);
    const apart = piece.map((p, i) => (loose[p] ? parts + p : label[i]));
    const [joined, classes] = joinSmall(graph, apart, limit, whole ? 0 : parts);
    const firm = new Array(classes).fill(false), of = [];
    joined.forEach((k, i) => { if (!loose[piece[i]]) firm[k] = true; of[piece[i]] = k; });
    return compact(joined.map((k, i) => (firm[k] ? k : of[largest[part[piece[i]]]])));
  }
  // ---- one part divided along the hierarchy
  function within(members) {
    const place = new Int32Array(n).fill(-1);
    members.forEach((cell, k) => { place[cell] = k; });
    const least = Array.from(place, (k) => (k < 0 ? Infinity : k));
    const sets = forest(n), kept = [];
    for (let u = 0; u < unions.length; u += 2) {
      const [a, b] = [sets.find(unions[u]), sets.find(unions[u + 1])].sort((x, y) => x - y);
      sets.join(a, b);
      const [one, two] = [least[a], least[b]];
      least[a] = Math.min(one, two);
      if (one < Infinity && two < Infinity) kept.push([one, two]);
    }
    let total = Math.fround(0);
    members.forEach((cell) => { total = Math.fround(total + area[cell]); });
    const scale = total > 0 ? total : 1;
    const graph = { pairs: [], length: [], area: members.map((cell) => Math.fround(area[cell] / scale)) };
    for (let e = 0; e < m; e++) {
      const [i, j] = [place[pairs[2 * e]], place[pairs[2 * e + 1]]];
      if (i >= 0 && j >= 0) { graph.pairs.push([i, j]); graph.length.push(length[e]); }
    }
    return { graph, unions: kept, small: Math.min(Math.fround(model.small / scale), 0.25) };
  }
  function split(members, k) {
    const tree = within(members), count = members.length;
    if (k > count) return null;
    const raw = (depth) => {
      const sets = forest(count);
      tree.unions.slice(0, count - depth).forEach(([i, j]) => sets.join(i, j));
      return compact(members.map((_, i) => sets.find(i)))[0];
    };
    const coarsest = (limit) => {
      const at = (depth) => smallParts(tree.graph, raw(depth), limit, true);
      let low = k - 1, high = k, cut = at(k);
      while (cut[1] < k) {
        if (high === count) return null;
        low = high;
        high = Math.min(2 * high + 8, count);
        cut = at(high);
      }
      while (high - low > 1) {
        const middle = Math.floor((low + high) / 2), found = at(middle);
        if (found[1] < k) low = middle;
        else [high, cut] = [middle, found];
      }
      return cut[1] === k ? cut[0] : null;
    };
    const limit = Math.min(tree.small, 0.25 / k);
    for (const share of [1, 0.7, 0.5, 0.3]) {
      const found = coarsest(share * limit);
      if (found) return found;
    }
    return smallParts(tree.graph, raw(k), limit, false)[0];
  }

  // ---- one part divided among places
  function divide(label, part, seeds) {
    const members = [];
    label.forEach((x, cell) => { if (x === part) members.push(cell); });
    const place = new Int32Array(n).fill(-1);
    members.forEach((cell, k) => { place[cell] = k; });
    const near = members.map(() => []), inside = [];
    for (let e = 0; e < m; e++) {
      const [i, j] = [place[pairs[2 * e]], place[pairs[2 * e + 1]]];
      if (i < 0 || j < 0) continue;
      near[i].push([j, steps[e]]);
      near[j].push([i, steps[e]]);
      inside.push([i, j, e]);
    }
    const best = new Float64Array(members.length).fill(Infinity), chosen = new Array(members.length);
    seeds.sort((a, b) => a[1] - b[1] || superfaces[a[0]] - superfaces[b[0]]);
    for (const [cell, number] of seeds) {
      const path = new Float64Array(members.length).fill(Infinity), queue = heap();
      path[place[cell]] = 0;
      queue.push(0, place[cell]);
      for (let top = queue.pop(); top; top = queue.pop()) {
        const [at, i] = top;
        if (at > path[i]) continue;
        for (const [j, step] of near[i]) if (at + step < path[j]) queue.push(path[j] = at + step, j);
      }
      members.forEach((other, k) => {
        const cost = 0.1 * Math.min(path[k], 1e3) - C(superfaces[cell], superfaces[other]);
        if (cost < best[k]) [best[k], chosen[k]] = [cost, number];
      });
    }
    seeds.forEach(([cell, number]) => { chosen[place[cell]] = number; });
    // Small pieces without a place join the side that shares the longest boundary with them.
    const graph = { pairs: inside };
    const [piece, count] = pieces(graph, chosen);
    const size = sums(piece, members.map((cell) => area[cell]), count);
    const loose = Array.from(size, (x) => x < model.small);
    seeds.forEach(([cell]) => { loose[piece[place[cell]]] = false; });
    const shared = new Map();
    for (const [i, j, e] of inside) {
      for (const [a, b] of [[i, j], [j, i]]) {
        if (piece[a] === piece[b] || !loose[piece[a]] || loose[piece[b]]) continue;
        if (!shared.has(piece[a])) shared.set(piece[a], new Map());
        const of = shared.get(piece[a]);
        of.set(chosen[b], (of.get(chosen[b]) || 0) + length[e]);
      }
    }
    members.forEach((cell, k) => {
      const of = shared.get(piece[k]);
      label[cell] = of ? [...of].reduce((a, b) => (b[1] > a[1] ? b : a))[0] : chosen[k];
    });
  }

  // The labels `base` changed as little as the hints among `edits` want; null where they contradict each other. Parts without a
  // hint keep their numbers.
  function hinted(base, edits) {
    const groups = [], apart = [];
    for (const { edit, cells } of edits) {
      const first = groups.length;
      if (edit === 'together') groups.push(cells);
      else if (edit === 'apart') cells.forEach((cell) => groups.push([cell]));
      for (let b = first; b < groups.length; b++) for (let a = first; a < b; a++) apart.push([a, b]);
    }
    const label = Array.from(base);
    if (!groups.length) return label;
    const sets = forest(groups.length), groupAt = new Map();
    groups.forEach((cells, group) => cells.forEach((cell) => {
      if (!groupAt.has(cell)) groupAt.set(cell, group);
      sets.join(group, groupAt.get(cell));
    }));
    const pairsApart = apart.map((pair) => pair.map(sets.find));
    if (pairsApart.some(([i, j]) => i === j)) return null;
    const parts = label.reduce((top, x) => Math.max(top, x), 0) + 1, byPart = new Map();
    for (const [cell, group] of [...groupAt].sort((a, b) => a[0] - b[0])) {
      const part = label[cell];
      if (!byPart.has(part)) byPart.set(part, []);
      byPart.get(part).push([cell, sets.find(group)]);
    }
    let classes = forest(groups.length);
    const now = label.slice();
    for (const [part, seeds] of [...byPart].sort((a, b) => a[0] - b[0])) {
      const trial = classes.copy();
      seeds.forEach(([, own]) => trial.join(seeds[0][1], own));
      if (pairsApart.every(([i, j]) => trial.find(i) !== trial.find(j))) {
        // The whole part is of one class.
        classes = trial;
        now.forEach((x, cell) => { if (x === part) now[cell] = parts + seeds[0][1]; });
      } else {
        const divided = label.slice();
        divide(divided, part, seeds);
        label.forEach((x, cell) => { if (x === part) now[cell] = parts + divided[cell]; });
      }
    }
    // A class is known by the first part that it has cells of and that no other class is known by.
    const known = new Map(), taken = new Set();
    let next = parts;
    now.forEach((x, cell) => {
      if (x < parts) return;
      const own = classes.find(x - parts);
      if (!known.has(own) && !taken.has(label[cell])) {
        known.set(own, label[cell]);
        taken.add(label[cell]);
      }
      now[cell] = parts + own;
    });
    return now.map((x) => {
      if (x < parts) return x;
      if (!known.has(x - parts)) known.set(x - parts, next++);
      return known.get(x - parts);
    });
  }

  // The labels of `count` parts of which some are as `edits` protect them in the cut that they were made on, `start`; and the edits
  // followed from there.
  function around(start, count, edits) {
    const own = follow(start, edits), ids = [...own.kept], outside = [];
    own.label.forEach((id, cell) => { if (!own.kept.has(id)) outside.push(cell); });
    const rest = outside.length ? count - ids.length : 0, pieces = outside.length && rest > 0 ? split(outside, rest) : [];
    if (outside.length && !(rest > 0 && pieces)) return { ...own, error: 'Some parts are protected: so few parts are not possible.' };
    const label = own.label.map((id) => rest + ids.indexOf(id));
    outside.forEach((cell, k) => { label[cell] = pieces[k]; });
    return follow(label, edits, (cell) => own.kept.has(own.label[cell]));
  }

  // Follows `edits` from the labels `base`, hints first; each edit has its `cells`. A part is known by a number that it keeps. `error` is
  // why the last edit cannot be followed. Edits within parts that are protected `already` have been followed.
  const marks = ['name', 'colour', 'drop', 'protect'];
  function follow(base, all, already = () => false) {
    const edits = all.filter(({ edit, cells }) => marks.includes(edit) || !cells.every(already));
    const sound = hinted(base, edits), label = sound || Array.from(base);
    const names = new Map(marked.names), colours = new Map(marked.colours), dropped = new Set(marked.dropped);
    const kept = new Set([...marked.kept, ...label.filter((_, cell) => already(cell))]);
    let next = label.reduce((top, x) => Math.max(top, x), -1) + 1, error = null;
    if (!sound) error = 'This contradicts another hint, or two of the places are too close.';
    for (const { edit, cells: [at] } of edits) {
      const changed = edit === 'protect' && label.some((x, cell) => (x === label[at]) !== (base[cell] === base[at]));
      if (changed) error = 'A hint would change a protected part.';
    }
    const changes = (part) => {
      if (kept.has(part)) error = 'This part is protected.';
      return !kept.has(part);
    };
    for (const { edit, cells, into, name, colour } of edits) {
      const first = label[cells[0]];
      if (edit === 'merge') {
        const others = new Set(cells.map((cell) => label[cell]).filter((part) => part !== first));
        if (!others.size) error = 'These are already one part.';
        else if ([first, ...others].every(changes)) {
          label.forEach((x, i) => { if (others.has(x)) label[i] = first; });
          // The part keeps what was said of any of its places, of the first one before others.
          for (const part of others) {
            for (const said of [names, colours]) {
              if (said.has(part) && !said.has(first)) said.set(first, said.get(part));
              said.delete(part);
            }
            if (dropped.delete(part)) dropped.add(first);
          }
        }
      } else if (edit === 'split' && changes(first)) {
        const members = [];
        label.forEach((x, cell) => { if (x === first) members.push(cell); });
        const found = split(members, into);
        if (!found) error = 'The part is too small for so many pieces.';
        else {
          found.forEach((piece, k) => { if (piece) label[members[k]] = next + piece - 1; });
          next += into - 1;
        }
      } else if (edit === 'cut') {
        if (cells[0] === cells[1]) error = 'The two places are too close.';
        else if (label[cells[1]] !== first) error = 'The two places are already on different parts.';
        else if (changes(first)) divide(label, first, [[cells[0], first], [cells[1], next++]]);
      } else if (edit === 'name') names.set(first, name);
      else if (edit === 'colour') colours.set(first, colour);
      else if (edit === 'drop' && changes(first)) dropped.add(first);
      else if (edit === 'protect') kept.add(first);
    }
    return { label, names, colours, dropped, kept, error };
  }
  // The cell of a part of `label` with the fewest steps from `cell`, as in src/pipeline/edits.rs.
  function nearest(label, cell, part) {
    const reached = new Set([cell]);
    for (let before = -1; before !== reached.size;) {
      before = reached.size;
      const found = [...reached].filter((x) => label[x] === part);
      if (found.length) return Math.min(...found);
      const next = [];
      for (let e = 0; e < m; e++) {
        const [a, b] = [pairs[2 * e], pairs[2 * e + 1]];
        if (reached.has(a) !== reached.has(b)) next.push(a, b);
      }
      next.forEach((x) => reached.add(x));
    }
    return cell;
  }
  return { start, follow, around, nearest, cells: n };
}

// A queue of [key, item], least key first.
function heap() {
  const keys = [], items = [];
  const swap = (i, j) => { [keys[i], keys[j], items[i], items[j]] = [keys[j], keys[i], items[j], items[i]]; };
  return {
    push(key, item) {
      let i = keys.push(key) - 1;
      items.push(item);
      for (let up = (i - 1) >> 1; i > 0 && keys[up] > keys[i]; up = (i - 1) >> 1) { swap(i, up); i = up; }
    },
    pop() {
      if (!keys.length) return null;
      swap(0, keys.length - 1);
      const top = [keys.pop(), items.pop()];
      for (let i = 0; ;) {
        let least = i;
        for (const k of [2 * i + 1, 2 * i + 2]) if (k < keys.length && keys[k] < keys[least]) least = k;
        if (least === i) return top;
        swap(i, least);
        i = least;
      }
    },
  };
}
