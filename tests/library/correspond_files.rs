//! Matches in files: each form is read again, and a table has what the array has.

use nystrom_stream::apps::correspond::files::{read, write};
use nystrom_stream::apps::correspond::matches::Match;
use nystrom_stream::store::{Run, npy};

/// A vertex with a match and one without.
const MATCHES: [Match; 2] = [Match { target: 7, distance: 0.25, confidence: 0.5 }, Match::NONE];

#[test]
fn matches_come_back_from_both_forms_and_maps_from_integers() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["m.npy", "m.csv"] {
        let path = dir.path().join(name);
        write(&path, &MATCHES, &Run::new(&())).unwrap();
        assert_eq!(read(&path).unwrap(), [Some(7), None]);
    }
    let path = dir.path().join("i.npy");
    npy::write::<u32>(&path, &[3, 1], 1, false).unwrap();
    assert_eq!(read(&path).unwrap(), [Some(3), Some(1)]);
    npy::write::<f32>(&path, &[3.], 1, false).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("has items"));
    std::fs::write(dir.path().join("x.csv"), "vertex,match,distance,confidence\n1,2,0,0\n").unwrap();
    assert!(read(&dir.path().join("x.csv")).unwrap_err().to_string().contains("line 2"));
    // Regression: a vertex beyond 32 bits counted as none; in a .npy it is an error.
    std::fs::write(dir.path().join("x.csv"), "vertex,match,distance,confidence\n0,-1,0,0\n1,4294967296,0,0\n").unwrap();
    assert!(read(&dir.path().join("x.csv")).unwrap_err().to_string().contains("line 3"));
    assert!(write(&dir.path().join("m.txt"), &MATCHES, &Run::new(&())).is_err());
}

#[cfg(feature = "parquet")]
#[test]
fn a_table_has_a_row_per_vertex() {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.parquet");
    write(&path, &MATCHES, &Run::new(&())).unwrap();
    let table = SerializedFileReader::new(std::fs::File::open(&path).unwrap()).unwrap();
    let rows: Vec<String> = table.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string()).collect();
    assert_eq!(rows[0], "{vertex: 0, match: 7, distance: 0.25, confidence: 0.5}");
    assert!(rows.len() == 2 && rows[1].starts_with("{vertex: 1, match: -1, distance: inf"), "{rows:?}");
}
