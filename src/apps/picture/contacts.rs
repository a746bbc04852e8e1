//! Which parts share vertices: enough to give neighbours unlike colours where nothing else is known of them.
//!
//! One pass in file order; 4 bytes a vertex.

use crate::base::Result;
use crate::mesh::{Mesh, colours};
use crate::store::Run;
use std::collections::BTreeMap;

/// Faces between two looks at the stop flag.
const CHUNK: usize = 1 << 16;
/// Parts above this number take colours in turn.
const MANY: usize = 2048;
const NONE: u32 = u32::MAX;

/// A colour-blind-safe colour a label, unlike between parts that touch.
///
/// # Errors
/// [`crate::base::Error::Cancelled`], [`crate::base::Error::Memory`].
pub fn colours_for(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Vec<[u8; 3]>> {
    let parts = labels.iter().copied().filter(|&label| label != NONE).max().map_or(0, |most| most as usize + 1);
    if parts > MANY {
        let some = colours::palette(colours::MOST);
        return Ok((0..parts).map(|part| some[part % some.len()]).collect());
    }
    let bytes = 4 * mesh.positions.len() as u64;
    let _grant = run.budget.take("the parts at vertices", bytes, bytes)?;
    let mut first = vec![NONE; mesh.positions.len()];
    let mut touching: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let n = mesh.faces.len();
    for start in (0..n).step_by(CHUNK) {
        run.cancel.check()?;
        mesh.faces.for_each(start..n.min(start + CHUNK), |face, corners| {
            let label = labels.get(face).copied().unwrap_or(NONE);
            for &corner in corners {
                let Some(known) = first.get_mut(corner as usize) else { continue };
                if *known == NONE {
                    *known = label;
                } else if *known != label && label != NONE {
                    *touching.entry(((*known).min(label), (*known).max(label))).or_default() += 1.0;
                }
            }
        });
    }
    let touching: Vec<_> = touching.into_iter().map(|((a, b), count)| (a, b, count)).collect();
    Ok(colours::assign(parts, &touching))
}
