//! The exact Fiedler order of a small mesh, component by component.

use super::fiedler::{envelope, fiedler};
use crate::base::Result;
use crate::graph::VertexAdjacency;
use crate::store::{Context, MappedSlice};

/// Entries of all envelopes at the most: 256 MiB.
const ENTRIES: usize = 1 << 25;
/// Vertices at the most.
const VERTICES: usize = 200_000;

/// Ranks of the vertices of `graph` along the Fiedler vectors of its components, which follow each other by their first
/// vertices in the order `good`, the one that keeps envelopes small; `None` where the mesh is not small, or memory is.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn ranks(
    name: &str,
    graph: &VertexAdjacency,
    good: &[u32],
    context: Context<'_>,
) -> Result<Option<MappedSlice<u32>>> {
    let n = graph.len();
    if n > VERTICES {
        return Ok(None);
    }
    let Ok(_grant) = context.run.budget.take("the exact order", 200 * n as u64, 200 * n as u64) else {
        return Ok(None);
    };
    let mut order = vec![0u32; n];
    good.iter().enumerate().for_each(|(v, &rank)| order[rank as usize] = v as u32);
    let mut local = vec![u32::MAX; n];
    let (mut components, mut entries) = (Vec::new(), 0);
    for &seed in &order {
        if local[seed as usize] != u32::MAX {
            continue;
        }
        local[seed as usize] = 0;
        let mut members = vec![seed];
        let mut at = 0;
        while at < members.len() {
            for &w in graph.neighbours(members[at]) {
                if local[w as usize] == u32::MAX {
                    local[w as usize] = 0;
                    members.push(w);
                }
            }
            at += 1;
        }
        members.sort_unstable_by_key(|&v| good[v as usize]);
        members.iter().enumerate().for_each(|(k, &v)| local[v as usize] = k as u32);
        let near = |&v: &u32| graph.neighbours(v).iter().map(|&w| local[w as usize]).collect();
        let rows: Vec<Vec<u32>> = members.iter().map(near).collect();
        entries += envelope(&rows);
        if entries > ENTRIES {
            return Ok(None);
        }
        components.push((members, rows));
    }
    let Ok(_grant) = context.run.budget.take("the exact order", 8 * entries as u64, 8 * entries as u64) else {
        return Ok(None);
    };
    let mut array = context.work.array::<u32>(name, &[n])?;
    let mut next = 0;
    for (members, rows) in components {
        let x = fiedler(&rows, &context.run.cancel)?;
        let mut along: Vec<usize> = (0..members.len()).collect();
        along.sort_by(|&a, &b| x[a].total_cmp(&x[b]).then(a.cmp(&b)));
        for k in along {
            array.data()[members[k] as usize] = next;
            next += 1;
        }
    }
    array.finish(false).map(Some)
}
