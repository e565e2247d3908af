//! Replays the seeds and findings of `fuzz/` through the body of the fuzz target.

#[path = "../../fuzz/replay.rs"]
mod replay;

use sm2_node::fuzz;

#[test]
fn every_seed() {
    replay::replay("domain_mirror", fuzz::domain_mirror);
}
