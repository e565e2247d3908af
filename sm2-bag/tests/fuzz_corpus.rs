//! Replays the seeds and findings of `fuzz/` through the body of the fuzz target, and some random inputs.

#[path = "../../fuzz/replay.rs"]
mod replay;

use sm2_bag::fuzz;

#[test]
fn every_seed() {
    replay::replay("bag_file", fuzz::bag_file);
}

#[test]
fn random_inputs() {
    let mut state = 1_u64;
    for _ in 0..500 {
        let mut input = Vec::new();
        for _ in 0..100 {
            // Numerical Recipes' linear congruential generator; its upper bits are random enough.
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            input.push((state >> 56) as u8);
        }
        fuzz::bag_file(&input);
    }
}
