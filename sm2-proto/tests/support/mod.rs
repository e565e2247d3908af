//! Helpers that several tests share.
#![allow(dead_code, reason = "each test uses a part")]

pub(crate) mod access;
pub(crate) mod bench;
pub(crate) mod contracts;
pub(crate) mod edit;
pub(crate) mod items;
pub(crate) mod matching;
pub(crate) mod onlooker;
pub(crate) mod oracle;
pub(crate) mod session;
pub(crate) mod world;

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
