//! Replays the seeds of `fuzz/corpus/` through the bodies of the fuzz targets.

use std::{fs, path::Path};

use sm2_proto::fuzz;

#[test]
fn every_seed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus");
    let mut targets = 0;
    for target in fs::read_dir(corpus).expect("the corpus is part of the project") {
        let target = target.expect("readable").path();
        let body = match target.file_name().and_then(|name| name.to_str()) {
            Some("domain_mirror") => fuzz::domain_mirror,
            Some("link_frames") => fuzz::link_frames,
            Some("manager_session") => fuzz::manager_session,
            Some("node_session") => fuzz::node_session,
            Some("schema_text") => fuzz::schema_text,
            other => panic!("{other:?} has no body here"),
        };
        let seeds = fs::read_dir(&target).expect("readable");
        let seeds: Vec<_> = seeds.map(|seed| seed.expect("readable").path()).collect();
        assert!(!seeds.is_empty(), "{target:?} has seeds");
        for seed in seeds {
            println!("{}", seed.display());
            body(&fs::read(seed).expect("readable"));
        }
        targets += 1;
    }
    assert_eq!(targets, 5);
}
