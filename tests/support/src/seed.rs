//! The seed of random tests.

use std::{
    env,
    hash::{BuildHasher as _, RandomState},
    sync::OnceLock,
};

/// Sets the seed.
const SEED: &str = "SM2_TEST_SEED";

/// The seed of all random choices of this process: the number in `SM2_TEST_SEED`, else one that is drawn. The first
/// call prints it, so that the report of a failed test has it.
///
/// # Panics
///
/// The variable has no number.
#[must_use]
pub fn seed() -> u64 {
    static DRAWN: OnceLock<u64> = OnceLock::new();
    let seed = *DRAWN.get_or_init(|| match env::var(SEED) {
        Ok(text) => text
            .parse()
            .unwrap_or_else(|_| panic!("{SEED}={text} is not a number")),
        Err(_) => RandomState::new().hash_one(0),
    });
    println!("{SEED}={seed}");
    seed
}

/// A number below `end` that follows from the [seed](seed()).
///
/// # Panics
///
/// `end` is 0.
#[must_use]
pub fn below(end: usize) -> usize {
    usize::try_from(seed() % end as u64).expect("it is below a usize")
}
