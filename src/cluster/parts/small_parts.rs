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
    let loose: Vec<bool> = (0..pieces).map(|p| area[p] < limit && largest[part[p] as usize] != p).collect();
    let apart: Vec<u32> =
        piece.iter().zip(&label).map(|(&p, &k)| if loose[p as usize] { parts as u32 + p } else { k }).collect();
    let (mut joined, classes) = join_small(pairs, length, shares, &apart, limit, if whole_too { 0 } else { parts });
    // Those that found no part beside them, on components of their own, stay with the part they
    // were of: no class may be made of loose pieces alone.
    let mut firm = vec![false; classes];
    let mut of_piece = vec![0u32; pieces];
    for (&k, &p) in joined.iter().zip(&piece) {
        firm[k as usize] |= !loose[p as usize];
        of_piece[p as usize] = k;
    }
    for (k, &p) in joined.iter_mut().zip(&piece).filter(|(k, _)| !firm[**k as usize]) {
        *k = of_piece[largest[part[p as usize] as usize]];
    }
    compact(&joined)
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
        // Two loose cells on a component of their own: back to their parts.
        let mut pairs = pairs;
        pairs.retain(|p| *p != [7, 8]);
        let torn = [0, 0, 0, 0, 1, 1, 1, 1, 0, 1];
        for whole_too in [false, true] {
            let kept = small_parts(&pairs, &[1.0; 8], &[0.1; 10], &torn, 0.15, whole_too);
            assert_eq!(kept, (torn.to_vec(), 2));
        }
    }
}
