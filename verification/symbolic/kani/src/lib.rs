//! The part of the `kani` API that SM2's harnesses use, answered by a symbolic engine.
//!
//! The functions named `sm2_symbolic_*` are hooks. `../engine` replaces them by its own procedures,
//! or answers their callbacks when it runs a path again on the processor.
#![no_std]

mod arbitrary;
#[path = "../../../kani-standin/src/composite.rs"]
mod composite;
mod hooks;
mod memory;

pub use arbitrary::{Arbitrary, any, any_where};
pub use sm2_symbolic_kani_macros::{proof, unwind};

/// Continues only with values that fulfil `condition`.
pub fn assume(condition: bool) {
    hooks::sm2_symbolic_assume(condition);
}

/// Fails this path if `condition` can be false.
///
/// # Panics
///
/// With `message`, if it does not hold.
#[track_caller]
pub fn assert(condition: bool, message: &'static str) {
    assert!(condition, "{message}");
}

/// States that some path reaches this place with `condition`.
#[macro_export]
macro_rules! cover {
    ($condition:expr, $text:literal) => {
        $crate::covered($condition, concat!(file!(), ":", line!(), ": ", $text))
    };
}

#[doc(hidden)]
pub fn covered(condition: bool, text: &'static str) {
    hooks::sm2_symbolic_cover(condition, text.as_ptr(), text.len());
}
