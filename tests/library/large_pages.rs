//! Pages of 2 MiB: which mappings ask for them.
#![cfg(target_os = "linux")]

use nystrom_stream::store::MappedBytes;
use nystrom_stream::store::access::{Access, reads_large_pages};

/// What the system says of the mapping of the file `name`: a list of short flags.
fn flags(name: &str) -> String {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let own = maps.split_once(name).expect("mapped").1;
    own.lines().find_map(|line| line.strip_prefix("VmFlags:")).unwrap().to_string()
}

#[test]
fn large_mappings_ask_for_large_pages_unless_they_are_read_at_random() {
    if !reads_large_pages() {
        println!("skipped: this kernel reads only small pages");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes, is_large) in [("large.bin", 8 << 20, true), ("small.bin", (8 << 20) - 1, false)] {
        let path = dir.path().join(name);
        std::fs::write(&path, vec![7; bytes]).unwrap();
        let map = MappedBytes::open(&path).unwrap();
        let random = Some(Access::Random);
        for (access, large, small) in
            [(None, is_large, false), (random, false, is_large), (Some(Access::Local), is_large, false)]
        {
            access.into_iter().for_each(|access| map.advise(access));
            let told = flags(name);
            let has = |flag| told.split_whitespace().any(|word| word == flag);
            assert_eq!((has("hg"), has("nh")), (large, small), "{name} {access:?}: {told}");
            assert!(map.iter().all(|byte| *byte == 7));
        }
    }
}
