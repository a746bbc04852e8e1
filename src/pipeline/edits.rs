//! Applies edits to a mesh: from faces to cells, and from cells to corrected parts.
//!
//! The faces at the places of edits ([`crate::apps::edits::PlacedEdits`]) are mapped to cells. Hints change the
//! labelling of the decision ([`crate::cluster::parts::hints`]), the other edits follow in order. All of this happens
//! on cells; afterwards boundaries are refined like those of any cut. Cost: one pass over the nodes to find the faces,
//! milliseconds on cells, and the refinement.

use crate::apps::edits::{Edit, Edits, PlacedEdits};
use crate::base::printable::counted;
use crate::base::sort::map_of;
use crate::base::tally::tally;
use crate::base::{Error, Result};
use crate::cluster::parts::cell_labels::compact;
use crate::cluster::parts::hints::{Affinities, Conflict, Hints};
use crate::cluster::parts::{PartCount, PartTree, TreeCut};
use crate::graph::NodeOrder;
use crate::mesh::ply::labelled::GREY;
use crate::store::Run;
use std::collections::{BTreeMap, BTreeSet};

/// Faces that a thread processes at once.
const CHUNK: usize = 1 << 15;
/// Number of rings of cells along boundaries within which refinement may move a boundary; an upper bound.
const BAND: usize = 3;
/// Maximum number of painted values that a note names.
const SHOWN_VALUES: usize = 10;

/// A person's corrections, in addition to the options of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corrections<'a> {
    /// Edits, on the mesh.
    pub edits: Option<&'a PlacedEdits<'a>>,
    /// Hints painted on faces, one value per face of the file (n): equal values belong together, different ones apart,
    /// 0 means no hint.
    pub painted: Option<&'a [u32]>,
    /// Whether `painted` was transferred from another mesh. It is then a guess about every face, and those whose hint
    /// stays unmet are not noted.
    pub transferred: bool,
}

/// Names and colours that a person has given to parts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PartMarks {
    /// Name of each part, empty if it has none; may be shorter than the number of parts.
    pub names: Vec<String>,
    /// Colour of some parts.
    pub colours: BTreeMap<u32, [u8; 3]>,
    /// The file of edits that produced the parts.
    pub edits: Option<String>,
    /// Whether the parts differ from the cut that the options give on the kept hierarchy: they are corrected, or cut
    /// from another hierarchy.
    pub corrected: bool,
    /// The key of the decision that was cut.
    pub decision: Option<String>,
}

impl PartMarks {
    /// The marks of only the parts `kept` (K), renumbered from 0.
    pub(super) fn of_parts(&self, kept: &[u32]) -> Self {
        let name = |part: &u32| self.names.get(*part as usize).cloned().unwrap_or_default();
        let colour = |(part, old): (u32, &u32)| Some((part, *self.colours.get(old)?));
        Self {
            names: if self.names.is_empty() { Vec::new() } else { kept.iter().map(name).collect() },
            colours: (0..).zip(kept).filter_map(colour).collect(),
            ..self.clone()
        }
    }
}

/// The name of dropped parts.
const DROPPED: &str = "dropped";

impl Corrections<'_> {
    /// Whether there is nothing to correct.
    pub fn is_empty(&self) -> bool {
        self.edits().is_none_or(|edits| edits.edits.is_empty()) && self.painted.is_none()
    }

    fn edits(&self) -> Option<&Edits> {
        self.edits.map(|placed| placed.edits)
    }

    /// The node of each face of each edit; there are `n` nodes.
    ///
    /// # Errors
    /// [`Error::Parameter`] for edits on another mesh; [`Error::Cancelled`].
    pub(super) fn nodes(&self, n: usize, order: &NodeOrder, run: &Run) -> Result<Vec<Vec<u32>>> {
        let Some(placed) = self.edits else { return Ok(Vec::new()) };
        let faces: BTreeSet<u32> = placed.faces.iter().flatten().copied().collect();
        let nodes = nodes_of(&faces, n, order, run)?;
        let node = |face: &u32| nodes.get(face).copied();
        let all = placed.faces.iter().map(|faces| faces.iter().map(node).collect::<Option<Vec<u32>>>());
        all.collect::<Option<Vec<Vec<u32>>>>()
            .filter(|nodes| nodes.iter().map(Vec::len).eq(placed.edits.edits.iter().map(|edit| edit.places().len())))
            .ok_or_else(|| Error::parameter("edits", "are not on this mesh", "place them on it"))
    }

    /// Notes which hints, cuts and merges are not satisfied: their two places, at `nodes`, are still in one part, or in
    /// two. This happens because boundaries are refined after parts were decided on cells; `labels` (n) are the final
    /// labels. Edits whose parts later edits may have joined or divided are not reported.
    pub(super) fn tell_unmet(&self, nodes: &[Vec<u32>], order: &NodeOrder, labels: &[u32], run: &Run) {
        let nothing = Edits::default();
        let edits = self.edits().unwrap_or(&nothing);
        let joins = |edit: &Edit| matches!(edit, Edit::Merge { .. } | Edit::Drop { .. });
        let divides = |edit: &Edit| matches!(edit, Edit::Split { .. } | Edit::Cut { .. });
        let (joined, divided) = (edits.edits.iter().rposition(joins), edits.edits.iter().rposition(divides));
        for (number, (edit, nodes)) in edits.edits.iter().zip(nodes).enumerate() {
            // Hints are applied before all other edits.
            let joined_after = joined.is_some_and(|last| last > number || edit.is_hint());
            let divided_after = divided.is_some_and(|last| last > number || edit.is_hint());
            // Whether having both places in one part is the problem, or having them in two.
            let (in_one, problem) = match edit {
                Edit::Apart { .. } | Edit::Cut { .. } if !joined_after => (true, "two of its places are in one part"),
                Edit::Together { .. } | Edit::Merge { .. } if !divided_after => (false, "its places are in two parts"),
                _ => continue,
            };
            let mut parts: Vec<u32> = nodes.iter().map(|&node| labels[node as usize]).collect();
            parts.sort_unstable();
            if parts.windows(2).any(|two| (two[0] == two[1]) == in_one) {
                let problem = format!("{problem} once boundaries are refined");
                run.progress.note(&edits.wrong(number, problem, "move them farther into the parts").to_string());
            }
        }
        if let Some(painted) = self.painted.filter(|_| !self.transferred) {
            let value = |node: u32| painted[order.face(node) as usize];
            tell_unmet_paint(value, labels, divided.is_none(), joined.is_none(), run);
        }
    }

    /// Rejects edits at nodes that belong to no ordinary part, as `own` tests: they have a label of their own.
    ///
    /// # Errors
    /// [`Error::Malformed`] naming the edit.
    pub(super) fn refuse_own(&self, nodes: &[Vec<u32>], what: &str, own: impl Fn(u32) -> bool) -> Result<()> {
        let Some(edits) = self.edits() else { return Ok(()) };
        match nodes.iter().position(|nodes| nodes.iter().any(|&node| own(node))) {
            Some(number) => {
                let problem = format!("one of its places is on {what}, which have a separate label");
                Err(edits.wrong(number, problem, "remove the edit, or leave them with the parts beside them"))
            }
            None => Ok(()),
        }
    }

    /// The painted value of each cell (S), 0 for none: the most frequent value of its painted faces.
    ///
    /// Faces that a person sees, under `label` (S), in another part than their cell's do not count: refined boundaries
    /// do not follow cells, and the hint would join that part. A value without any other faces keeps these.
    fn painted_cells(&self, surface: OnCells<'_>, label: &[u32]) -> Result<Vec<u32>> {
        let Some(painted) = self.painted else { return Ok(Vec::new()) };
        let OnCells { order, cell, seen, .. } = surface;
        let values = || {
            let nodes = order.order.as_ref().map_or(painted.len(), |order| order.len()) as u32;
            let all = (0..nodes).map(|node| (node, painted[order.face(node) as usize]));
            all.filter(|(_, value)| *value != 0)
        };
        let mut counts = tally(values().map(|(node, value)| (cell(node), value)));
        if !self.transferred {
            seen(label, &mut |parts| {
                let inside = |node: u32| parts[node as usize] == label[cell(node) as usize];
                let known = tally(values().filter(|(node, _)| inside(*node)).map(|(node, value)| (cell(node), value)));
                let found: BTreeSet<u32> = known.keys().map(|(_, value)| *value).collect();
                counts.retain(|(_, value), _| !found.contains(value));
                counts.extend(known);
            })?;
        }
        let mut best = vec![(0u64, 0u32); label.len()];
        for ((cell, value), count) in counts {
            let best = best.get_mut(cell as usize).ok_or_else(|| Error::internal("a cell beyond the last"))?;
            if count > best.0 {
                *best = (count, value);
            }
        }
        Ok(best.into_iter().map(|(_, value)| value).collect())
    }

    /// Corrects `cut`, the result of the options `asked`.
    ///
    /// If the edits state from which cut they start and another one is requested, protected parts stay as they are in
    /// the former: their surroundings are cut into the remaining number of parts along the hierarchy.
    /// # Errors
    /// [`Error::Malformed`] naming the edit that cannot be applied.
    pub(super) fn apply(
        &self,
        surface: OnCells<'_>,
        asked: (PartCount, f64),
        cut: TreeCut,
    ) -> Result<(TreeCut, PartMarks)> {
        let nothing = Edits::default();
        let edits = self.edits().unwrap_or(&nothing);
        let OnCells { affinities, tree, .. } = surface;
        let start = start(edits, tree.cells()).filter(|start| *start != asked);
        let own = start.map(|(count, detail)| tree.cut_for(count, detail)).transpose()?;
        let shown = &own.as_ref().unwrap_or(&cut).label;
        let (cells, painted) = (surface.places(shown)?, self.painted_cells(surface, shown)?);
        let follow = |label: &[u32], kept: &[Option<usize>]| {
            let kept = if kept.is_empty() { &vec![None; label.len()] } else { kept };
            let within = |number: usize| cells[number].iter().all(|&cell| kept[cell as usize].is_some());
            let done: Vec<bool> =
                edits.edits.iter().enumerate().map(|(number, edit)| !edit.is_mark() && within(number)).collect();
            let label = hinted(edits, &cells, &done, &painted, affinities, label)?;
            let mut state = State::new(edits, &cells, affinities, tree, label);
            state.protected = state.label.iter().zip(kept).filter_map(|(&part, by)| Some((part, (*by)?))).collect();
            (0..edits.edits.len()).filter(|&number| !done[number]).try_for_each(|number| state.follow(number))?;
            Ok(state)
        };
        let state = match own {
            Some(own) => {
                let own = follow(&own.label, &[])?;
                let kept: Vec<Option<usize>> = own.label.iter().map(|part| own.protected.get(part).copied()).collect();
                follow(&around(edits, tree, &own, &kept, cut.parts)?, &kept)?
            }
            None => follow(&cut.label, &[])?,
        };
        let (cut, marks) = state.finish();
        Ok((cut, PartMarks { edits: self.edits().map(Edits::text).transpose()?, ..marks }))
    }
}

/// Notes how many painted faces are outside the part of their value, if `together` is set, and which values share a
/// part, if `apart` is. `value` is the painted value of a node, `labels` (n) are the final labels. The part of a value
/// is the one that contains most of its faces.
fn tell_unmet_paint(value: impl Fn(u32) -> u32, labels: &[u32], together: bool, apart: bool, run: &Run) {
    let pairs = (0u32..).zip(labels).map(|(node, &part)| (value(node), part));
    // Of each value: its part, the number of its faces there, and of all of its faces.
    let mut values: BTreeMap<u32, (u32, u64, u64)> = BTreeMap::new();
    for ((value, part), faces) in tally(pairs.filter(|(value, _)| *value != 0)) {
        let (own, most, all) = values.entry(value).or_default();
        *all += faces;
        if faces > *most {
            (*own, *most) = (part, faces);
        }
    }
    let all: u64 = values.values().map(|(_, _, all)| all).sum();
    let outside = all - values.values().map(|(_, most, _)| most).sum::<u64>();
    if together && outside > 0 {
        run.progress.note(&format!(
            "painted hints: {outside} of {all} faces are outside the part of their value once boundaries are refined; \
             paint farther into the parts"
        ));
    }
    // The value with most faces in each part.
    let mut first: BTreeMap<u32, (u64, u32)> = BTreeMap::new();
    for (&value, &(part, most, _)) in &values {
        let first = first.entry(part).or_default();
        if most > first.0 {
            *first = (most, value);
        }
    }
    let joined = values.iter().filter_map(|(&value, (part, ..))| Some((value, first.get(part)?.1)));
    let joined: Vec<String> = joined.filter(|(a, b)| a != b).map(|(a, b)| format!("{a} with {b}")).collect();
    if apart && !joined.is_empty() {
        let shown = joined[..joined.len().min(SHOWN_VALUES)].join(", ");
        let more = joined.len().checked_sub(SHOWN_VALUES + 1).map_or(String::new(), |k| format!(" and {} more", k + 1));
        run.progress.note(&format!(
            "painted hints: different values are in one part: {shown}{more}; paint more faces of each, farther apart"
        ));
    }
}

/// Passes on the part of each node (n) after refinement of boundaries, given a label per cell.
pub(super) type PartsSeen<'a> = &'a dyn Fn(&[u32], &mut dyn FnMut(&[u32])) -> Result<()>;

/// A surface on which edits are applied.
#[derive(Clone, Copy)]
pub(super) struct OnCells<'a> {
    /// The nodes from [`Corrections::nodes`].
    pub nodes: &'a [Vec<u32>],
    /// Maps faces of the file to nodes.
    pub order: &'a NodeOrder,
    /// The cell of a node.
    pub cell: &'a dyn Fn(u32) -> u32,
    /// The parts of nodes under given cell labels, after refinement of boundaries.
    pub seen: PartsSeen<'a>,
    /// How strongly cells belong together.
    pub affinities: Affinities<'a>,
    /// The hierarchy of the cells.
    pub tree: &'a PartTree,
}

impl OnCells<'_> {
    /// The cells for the places of each edit, if the edits are based on the cut `label` (S): the cell at the place, or
    /// the nearest cell of the part that a person sees there. Refined boundaries do not follow cells, so a place near a
    /// boundary may lie in a cell of the part on the other side.
    fn places(&self, label: &[u32]) -> Result<Vec<Vec<u32>>> {
        let pairs = &self.affinities.cells.pairs;
        let mut beside = vec![false; label.len()];
        for step in 0..BAND {
            let before = beside.clone();
            for &[a, b] in pairs {
                let (i, j) = (a as usize, b as usize);
                let reached = if step == 0 { label[i] != label[j] } else { before[i] || before[j] };
                (beside[i], beside[j]) = (beside[i] || reached, beside[j] || reached);
            }
        }
        let mut near: Vec<u32> = self.nodes.iter().flatten().copied().collect();
        near.retain(|&node| beside[(self.cell)(node) as usize]);
        let mut seen = BTreeMap::new();
        if !near.is_empty() {
            (self.seen)(label, &mut |parts| seen = map_of(near.iter().map(|&node| (node, parts[node as usize]))))?;
        }
        let place = |&node: &u32| {
            let cell = (self.cell)(node);
            seen.get(&node).map_or(cell, |&part| nearest_cell(pairs, label, cell, part))
        };
        Ok(self.nodes.iter().map(|nodes| nodes.iter().map(place).collect()).collect())
    }
}

/// The cell of `part` with the fewest steps from `cell`: `cell` itself if it is in the part, or if no cell of the part
/// is reachable.
fn nearest_cell(pairs: &[[u32; 2]], label: &[u32], cell: u32, part: u32) -> u32 {
    let mut reached = BTreeSet::from([cell]);
    loop {
        if let Some(&found) = reached.iter().find(|&&cell| label[cell as usize] == part) {
            return found;
        }
        let before = reached.len();
        let next: Vec<u32> = pairs
            .iter()
            .filter_map(|&[a, b]| match (reached.contains(&a), reached.contains(&b)) {
                (true, false) => Some(b),
                (false, true) => Some(a),
                _ => None,
            })
            .collect();
        reached.extend(next);
        if reached.len() == before {
            return cell;
        }
    }
}

/// The cut of `cells` cells from which `edits` start, if they protect parts of it.
fn start(edits: &Edits, cells: usize) -> Option<(PartCount, f64)> {
    if !edits.protects() {
        return None;
    }
    let exactly = edits.parts.map(|parts| (PartCount::Exactly(parts).at_most(cells), 0.));
    Some(exactly.unwrap_or((PartCount::Found, edits.detail.unwrap_or(0.))))
}

/// The label of each cell when cut into `parts` parts, some of which are `kept`, namely those of `own` that `edits`
/// protect.
fn around(edits: &Edits, tree: &PartTree, own: &State<'_>, kept: &[Option<usize>], parts: usize) -> Result<Vec<u32>> {
    let ids: Vec<u32> = own.protected.keys().copied().filter(|part| own.label.contains(part)).collect();
    let outside: Vec<u32> = (0..kept.len() as u32).filter(|&cell| kept[cell as usize].is_none()).collect();
    let rest = if outside.is_empty() { 0 } else { parts.saturating_sub(ids.len()) };
    let few = |_| {
        let last = own.protected.values().copied().max().unwrap_or(0);
        let (protected, parts) = (counted(ids.len(), "protected part"), counted(parts, "part"));
        let problem = format!("{protected} and the rest cannot make {parts}");
        edits.wrong(last, problem, "request another number of parts, or remove the edit")
    };
    let pieces = if outside.is_empty() { Vec::new() } else { tree.split(&outside, rest).map_err(few)? };
    let place = |part: &u32| ids.iter().position(|id| id == part).map_or(0, |place| (rest + place) as u32);
    let mut label: Vec<u32> = own.label.iter().map(place).collect();
    outside.iter().zip(pieces).for_each(|(&cell, piece)| label[cell as usize] = piece);
    Ok(label)
}

/// The nodes of some faces of the file.
fn nodes_of(faces: &BTreeSet<u32>, n: usize, order: &NodeOrder, run: &Run) -> Result<BTreeMap<u32, u32>> {
    if order.order.is_none() || faces.is_empty() {
        return Ok(map_of(faces.iter().filter(|&&face| (face as usize) < n).map(|&face| (face, face))));
    }
    let found = run.map_ranges(n, CHUNK, |range| {
        Ok(range
            .map(|node| (order.face(node as u32), node as u32))
            .filter(|(face, _)| faces.contains(face))
            .collect::<Vec<_>>())
    })?;
    Ok(map_of(found.into_iter().flatten()))
}

/// The labelling of cells that satisfies the hints of `edits`, except those already `done`, and the painted values.
fn hinted(
    edits: &Edits,
    cells: &[Vec<u32>],
    done: &[bool],
    painted: &[u32],
    affinities: Affinities<'_>,
    label: &[u32],
) -> Result<Vec<u32>> {
    // The edit of each group; `None` for painted values.
    let (mut hints, mut of_edit) = (Hints::default(), Vec::new());
    for (number, edit) in edits.edits.iter().enumerate().filter(|(number, edit)| edit.is_hint() && !done[*number]) {
        let first = hints.groups.len();
        match edit {
            Edit::Together { .. } => hints.groups.push(cells[number].clone()),
            _ => hints.groups.extend(cells[number].iter().map(|&cell| vec![cell])),
        }
        hints.apart.push((first..hints.groups.len()).collect());
        of_edit.resize(hints.groups.len(), Some(number));
    }
    let mut values: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (cell, &value) in (0u32..).zip(painted).filter(|(_, value)| **value != 0) {
        values.entry(value).or_default().push(cell);
    }
    let first = hints.groups.len();
    hints.groups.extend(values.into_values());
    hints.apart.push((first..hints.groups.len()).collect());
    of_edit.resize(hints.groups.len(), None);
    if hints.groups.is_empty() {
        return Ok(label.to_vec());
    }
    let new = match affinities.satisfy(&hints, label) {
        Ok((new, _)) => new,
        Err(Conflict([a, b])) => {
            let number = of_edit[a].max(of_edit[b]).unwrap_or(0);
            let problem = if hints.groups[a].iter().any(|cell| hints.groups[b].contains(cell)) {
                "two of its places are so close that they lie in one of the two thousand cells of the surface"
            } else {
                "its places belong together by other hints"
            };
            return Err(edits.wrong(number, problem, "move a place, or remove one of the hints"));
        }
    };
    for (number, _) in edits.edits.iter().enumerate().filter(|(_, edit)| matches!(edit, Edit::Protect { .. })) {
        let at = cells[number][0] as usize;
        if (0..label.len()).any(|cell| (label[cell] == label[at]) != (new[cell] == new[at])) {
            let remedy = "remove the hint that has a place on the part, or this edit";
            return Err(edits.wrong(number, "a hint changes the part", remedy));
        }
    }
    Ok(new)
}

/// Parts while edits are applied. Each part is identified by a number that never changes.
struct State<'a> {
    edits: &'a Edits,
    cells: &'a [Vec<u32>],
    affinities: Affinities<'a>,
    tree: &'a PartTree,
    label: Vec<u32>,
    next: u32,
    names: BTreeMap<u32, String>,
    colours: BTreeMap<u32, [u8; 3]>,
    dropped: BTreeSet<u32>,
    /// Protected parts, and the edits that protect them.
    protected: BTreeMap<u32, usize>,
}

impl<'a> State<'a> {
    fn new(
        edits: &'a Edits,
        cells: &'a [Vec<u32>],
        affinities: Affinities<'a>,
        tree: &'a PartTree,
        label: Vec<u32>,
    ) -> Self {
        let next = label.iter().max().map_or(0, |top| top + 1);
        let (names, colours) = (BTreeMap::new(), BTreeMap::new());
        let (dropped, protected) = (BTreeSet::new(), BTreeMap::new());
        Self { edits, cells, affinities, tree, label, next, names, colours, dropped, protected }
    }

    /// Applies edit `number`.
    fn follow(&mut self, number: usize) -> Result<()> {
        let cells = &self.cells[number];
        let part = |cell: u32| self.label[cell as usize];
        let first = part(cells[0]);
        match &self.edits.edits[number] {
            Edit::Together { .. } | Edit::Apart { .. } => {}
            Edit::Merge { .. } => {
                let others: BTreeSet<u32> =
                    cells.iter().map(|&cell| part(cell)).filter(|&other| other != first).collect();
                if !others.is_empty() {
                    self.check(number, first)?;
                    others.iter().try_for_each(|&other| self.check(number, other))?;
                    let before: Vec<u32> = cells.iter().map(|&cell| part(cell)).collect();
                    self.label.iter_mut().filter(|label| others.contains(label)).for_each(|label| *label = first);
                    // The merged part keeps the name and colour of its places, with priority for the first one.
                    for other in before {
                        if let Some(name) = self.names.remove(&other) {
                            self.names.entry(first).or_insert(name);
                        }
                        if let Some(colour) = self.colours.remove(&other) {
                            self.colours.entry(first).or_insert(colour);
                        }
                        if self.dropped.remove(&other) {
                            self.dropped.insert(first);
                        }
                    }
                }
            }
            Edit::Split { into, .. } => {
                self.check(number, first)?;
                let members: Vec<u32> = (0..self.label.len() as u32).filter(|&cell| part(cell) == first).collect();
                let pieces = self.tree.split(&members, *into).map_err(|_| {
                    let problem = format!("the part has {}, too few for {into} pieces", counted(members.len(), "cell"));
                    self.edits.wrong(number, problem, "split into fewer")
                })?;
                for (cell, piece) in members.into_iter().zip(pieces).filter(|(_, piece)| *piece > 0) {
                    self.label[cell as usize] = self.next + piece - 1;
                }
                self.next += *into as u32 - 1;
            }
            Edit::Cut { .. } => {
                let (a, b) = (cells[0], cells[1]);
                if a == b {
                    let problem =
                        "its places are so close that they lie in one of the two thousand cells of the surface";
                    return Err(self.edits.wrong(number, problem, "place them farther apart"));
                }
                if part(b) == first {
                    self.check(number, first)?;
                    let new = self.next;
                    for (cell, class) in self.affinities.divide(&self.label, first, &[(a, first), (b, new)]) {
                        self.label[cell as usize] = class;
                    }
                    self.next += 1;
                }
            }
            Edit::Name { name, .. } => {
                self.names.insert(first, name.clone());
            }
            Edit::Colour { colour, .. } => {
                self.colours.insert(first, colour.0);
            }
            Edit::Drop { .. } => {
                self.check(number, first)?;
                self.dropped.insert(first);
            }
            Edit::Protect { .. } => {
                self.protected.insert(first, number);
            }
        }
        Ok(())
    }

    /// Rejects a change to a protected part.
    fn check(&self, number: usize, part: u32) -> Result<()> {
        let Some(by) = self.protected.get(&part) else { return Ok(()) };
        let problem = format!("would change a part that edit {} protects", by + 1);
        Err(self.edits.wrong(number, problem, "remove one of the two edits"))
    }

    /// The parts, numbered by first appearance, dropped ones last.
    fn finish(mut self) -> (TreeCut, PartMarks) {
        // A part that was merged into another has no cells left.
        let live: BTreeSet<u32> = self.label.iter().copied().collect();
        self.dropped.retain(|part| live.contains(part));
        let kept: Vec<u32> = self.label.iter().copied().filter(|part| !self.dropped.contains(part)).collect();
        let (numbers, count) = compact(&kept);
        let mut number = map_of(kept.into_iter().zip(numbers));
        number.extend(self.dropped.iter().map(|&part| (part, count as u32)));
        let parts = count + usize::from(!self.dropped.is_empty());
        let mut marks = PartMarks::default();
        if !self.names.is_empty() || !self.dropped.is_empty() {
            marks.names = vec![String::new(); parts];
        }
        for (part, name) in self.names {
            if let Some(&number) = number.get(&part) {
                marks.names[number as usize] = name;
            }
        }
        marks.colours = map_of(self.colours.iter().filter_map(|(part, &rgb)| Some((*number.get(part)?, rgb))));
        if parts > count {
            marks.names[count] = DROPPED.into();
            marks.colours.insert(count as u32, GREY);
        }
        let label = self.label.iter().map(|part| number[part]).collect();
        (TreeCut { label, parts }, marks)
    }
}
