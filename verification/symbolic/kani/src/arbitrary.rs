//! Arbitrary values.

use crate::{assume, hooks::sm2_symbolic_any};

/// A type that [`any`] can make.
pub trait Arbitrary: Sized {
    /// Returns an arbitrary value of the type.
    fn any() -> Self;
}

/// Returns an arbitrary value.
#[must_use]
pub fn any<T: Arbitrary>() -> T {
    T::any()
}

/// Returns an arbitrary value that `holds` accepts.
pub fn any_where<T: Arbitrary>(holds: impl FnOnce(&T) -> bool) -> T {
    let value = T::any();
    assume(holds(&value));
    value
}

impl Arbitrary for bool {
    fn any() -> Self {
        sm2_symbolic_any(1) != 0
    }
}

macro_rules! integers {
    ($($int:ty),*) => {$(
        impl Arbitrary for $int {
            fn any() -> Self {
                sm2_symbolic_any(Self::BITS) as Self
            }
        }
    )*};
}

integers!(u8, i8, u16, i16, u32, i32, u64, i64, usize, isize);

impl Arbitrary for u128 {
    fn any() -> Self {
        Self::from(u64::any()) << 64 | Self::from(u64::any())
    }
}

impl Arbitrary for i128 {
    fn any() -> Self {
        u128::any() as Self
    }
}
