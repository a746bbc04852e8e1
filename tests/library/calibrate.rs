//! Calibration tells what the stages of a run take.

use nystrom_stream::pipeline::SegmentParams;
use nystrom_stream::pipeline::calibrate::calibrate;
use nystrom_stream::store::Run;

/// Noise costs normals, and no stage is lost on the way to the plan.
#[test]
fn a_rough_surface_takes_longer_than_a_smooth_one() {
    let folder = tempfile::tempdir().unwrap();
    let params = SegmentParams::default();
    let times = calibrate(&params, 20, 20_000, folder.path(), false, &Run::new(&())).unwrap();
    assert!(["graph", "surface", "weights", "rows", "labels"].iter().all(|&name| times.smooth.contains_key(name)));
    for (stage, rough) in &times.rough {
        assert!(rough.of(20_000) >= times.smooth[stage].of(20_000), "{stage}");
    }
}
