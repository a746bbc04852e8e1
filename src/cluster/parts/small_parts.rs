//! Dust after the decision: parts, and loose pieces of parts, too small to be meant.

use super::cells::{class_sums, compact, connected_pieces, join_small};

/// Pieces below this share of the area join the neighbour with the longest common boundary.
pub const SMALL_PART: f64 = 0.003;

/// Joins connected pieces with less than `limit` of the area to their neighbours, smallest first.
///
/// `label` is a part a cell, `shares` area shares. With `whole_too` parts that are small as a
/// whole go as well; without, the largest piece of every part stays, and so does their number.
/// Returns labels numbered by first appearance, and how many.
pub fn small_parts(
    pairs: &[[u32; 2]],
    length: &[f64],
    shares: &[f64],
    label: &[u32],
    limit: f64,
    whole_too: bool,
) -> (Vec<u32>, usize) {
    let (label, parts) = compact(label);
    let (piece, pieces) = connected_pieces(pairs, &label);
    let area = class_sums(&piece, shares, pieces);
    let mut part = vec![0u32; pieces];
    for (&p, &k) in piece.iter().zip(&label) {
        part[p as usize] = k;
    }
    let mut largest = vec![usize::MAX; parts];
    for (p, &k) in part.iter().enumerate() {
        let best = &mut largest[k as usize];
        if *best == usize::MAX || area[p] > area[*best] {
            *best = p;
        }
    }
    // Loose small pieces become classes of their own, numbered after the parts.
    let apart: Vec<u32> = piece
        .iter()
        .zip(&label)
        .map(|(&p, &k)| {
            let p = p as usize;
            if area[p] < limit && largest[k as usize] != p { (parts + p) as u32 } else { k }
        })
        .collect();
    join_small(pairs, length, shares, &apart, limit, if whole_too { 0 } else { parts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn islands_join_and_the_number_asked_for_stays() {
        let pairs: Vec<[u32; 2]> = (1..10u32).map(|i| [i - 1, i]).collect();
        let label = [0, 0, 0, 1, 0, 0, 2, 2, 2, 3];
        let all = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &label, 0.15, true);
        assert_eq!(all.1, 2);
        let kept = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &label, 0.15, false);
        assert_eq!(kept, (vec![0, 0, 0, 1, 0, 0, 2, 2, 2, 3], 4));
        let loose = [0, 0, 0, 1, 0, 1, 1, 1, 2, 2];
        let kept = small_parts(&pairs, &[1.0; 9], &[0.1; 10], &loose, 0.15, false);
        assert_eq!(kept.1, 3);
        assert_eq!(kept.0[3], 0);
    }
}
