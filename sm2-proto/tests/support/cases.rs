//! The number of cases of a random test.

use proptest::test_runner::Config;

/// This many cases with the feature `slow`, an eighth of them without, unless `PROPTEST_CASES` sets another number.
pub(crate) fn cases(all: u32) -> Config {
    let chosen = std::env::var_os("PROPTEST_CASES").is_some();
    let cases = match (chosen, cfg!(feature = "slow")) {
        (true, _) => Config::default().cases,
        (false, true) => all,
        (false, false) => all.div_ceil(8),
    };
    Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    }
}
