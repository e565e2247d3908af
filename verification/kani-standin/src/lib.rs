//! The part of the `kani` API that SM2's harnesses use, for plain `cargo test`.
//!
//! Kani proves a harness for every value of [`any`]. This crate runs the harness: depth first over
//! all choices if they are few, else with boundary values and seeded samples. Such a run is a test,
//! not a proof. Depend on it as `kani = { package = "sm2-kani-standin", … }`, for tests only.

mod arbitrary;
mod composite;
mod results;
mod runner;

pub use arbitrary::{Arbitrary, any, any_where};
pub use runner::{Failure, Limits, Mode, Report, choose, explore, run};

#[doc(hidden)]
pub use runner::covered;

/// Abandons this path without a failure unless `condition` holds.
pub fn assume(condition: bool) {
    runner::assume(condition);
}

/// Fails this path unless `condition` holds.
///
/// # Panics
///
/// With `message`, if it does not hold.
pub fn assert(condition: bool, message: &'static str) {
    assert!(condition, "{message}");
}

/// States that some path reaches this place with `condition`: [`explore`] counts it.
#[macro_export]
macro_rules! cover {
    ($condition:expr, $text:literal) => {
        $crate::covered(concat!(file!(), ":", line!(), ": ", $text), $condition)
    };
}

/// A test for each named harness of this module, with the number of its covers.
#[macro_export]
macro_rules! explored {
    ($($harness:ident: $covers:literal,)*) => {
        mod explored {
            $(
                #[test]
                fn $harness() {
                    let test = concat!(module_path!(), "::", stringify!($harness));
                    $crate::explore(test, &$crate::Limits::new($covers), super::$harness);
                }
            )*
        }
    };
}
