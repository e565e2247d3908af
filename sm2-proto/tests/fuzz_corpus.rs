//! Replays the seeds and findings of `fuzz/` through the bodies of the fuzz targets.

use crate::fuzzed;
#[path = "../../fuzz/replay.rs"]
mod replay;

use sm2_proto::fuzz;

/// The body of a target, or the crate that has it and replays its seeds.
type Body = Result<fn(&[u8]), &'static str>;

/// Every target of `fuzz/`.
const TARGETS: [(&str, Body); 17] = [
    ("bag_file", Err("sm2-bag")),
    ("command_line", Err("sm2-cli")),
    ("control_codec", Ok(fuzzed::control_codec)),
    ("counters_page", Err("sm2-cli")),
    ("domain_mirror", Err("sm2-node")),
    ("gateway_discovery", Ok(fuzz::gateway_discovery)),
    ("gateway_frames", Ok(fuzzed::gateway_frames)),
    ("gateway_session", Ok(fuzz::gateway_session)),
    ("link_frames", Ok(fuzz::link_frames)),
    ("link_pair", Ok(fuzzed::link_pair)),
    ("manager_session", Ok(fuzz::manager_session)),
    ("node_session", Ok(fuzz::node_session)),
    ("ring_words", Ok(fuzz::ring_words)),
    ("ros_definition", Err("sm2-ros")),
    ("ros_message", Err("sm2-ros")),
    ("schema_text", Err("sm2-cli")),
    ("takeover", Ok(fuzzed::takeover)),
];

#[test]
fn every_seed() {
    for (target, body) in TARGETS {
        if let Ok(body) = body {
            replay::replay(target, body);
        }
    }
}

/// Each target has seeds, and a test that replays them.
#[test]
fn every_target() {
    let names: Vec<_> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(replay::targets(), names);
    assert_eq!(replay::corpora(), names);
    for (target, body) in TARGETS {
        if let Err(elsewhere) = body {
            let folder = if elsewhere == "sm2-cli" {
                "tests/cli"
            } else {
                "tests"
            };
            let test = format!("../{elsewhere}/{folder}/fuzz_corpus.rs");
            let text = std::fs::read_to_string(&test).expect("it replays that target");
            assert!(text.contains(&format!("\"{target}\"")), "{test}: {target}");
        }
    }
}
