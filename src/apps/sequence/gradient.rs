//! Colours of places, for a picture: blue where a mesh begins, yellow where it ends.

use crate::base::Result;
use crate::store::{MappedSlice, WorkDir};

/// Steps of the gradient; every other tenth is darker, so that the front's shape shows.
const STEPS: usize = 240;
/// Steps a band.
const BAND: usize = 12;
/// Colours on the way, evenly.
const STOPS: [[f64; 3]; 5] =
    [[38., 60., 140.], [40., 120., 170.], [60., 170., 130.], [150., 200., 80.], [250., 225., 70.]];

/// Labels of faces by their place in steps, as a temporary array of `work`, and the steps' colours.
///
/// # Errors
/// [`crate::base::Error::Io`].
pub fn gradient(places: &[u32], work: &WorkDir) -> Result<(MappedSlice<u32>, Vec<[u8; 3]>)> {
    let n = places.len().max(1) as u64;
    let mut array = work.array::<u32>("gradient.tmp", &[places.len()])?;
    let step = |place: u32| (u64::from(place) * STEPS as u64 / n).min(STEPS as u64 - 1) as u32;
    array.data().iter_mut().zip(places).for_each(|(label, &place)| *label = step(place));
    let colour = |k: usize| {
        let at = k as f64 / (STEPS - 1) as f64 * (STOPS.len() - 1) as f64;
        let (low, part) = ((at as usize).min(STOPS.len() - 2), at - (at as usize).min(STOPS.len() - 2) as f64);
        let shade = if k / BAND % 2 == 1 { 0.8 } else { 1. };
        [0, 1, 2].map(|c| (shade * ((1. - part) * STOPS[low][c] + part * STOPS[low + 1][c])) as u8)
    };
    Ok((array.finish(false)?, (0..STEPS).map(colour).collect()))
}
