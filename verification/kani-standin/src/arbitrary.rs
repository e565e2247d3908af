//! Arbitrary values.

use crate::runner::{assume, choose, choose_where, sixteen, wide};

/// A type that [`any`] can make.
pub trait Arbitrary: Sized {
    /// Returns an arbitrary value of the type.
    fn any() -> Self;

    /// Returns an arbitrary value that `holds` accepts. If there are few values, tries
    /// only such values.
    fn any_where(holds: impl Fn(&Self) -> bool) -> Self {
        let value = Self::any();
        assume(holds(&value));
        value
    }
}

/// Returns an arbitrary value.
#[must_use]
pub fn any<T: Arbitrary>() -> T {
    T::any()
}

/// Returns an arbitrary value that `holds` accepts. `holds` must be a pure function.
pub fn any_where<T: Arbitrary>(holds: impl Fn(&T) -> bool) -> T {
    T::any_where(holds)
}

impl Arbitrary for bool {
    fn any() -> Self {
        choose(2) == 1
    }
}

macro_rules! narrow {
    ($($int:ty),*) => {$(
        impl Arbitrary for $int {
            fn any() -> Self {
                choose(256) as Self
            }

            fn any_where(holds: impl Fn(&Self) -> bool) -> Self {
                choose_where(|value| holds(&(value as Self))) as Self
            }
        }
    )*};
}

narrow!(u8, i8);

macro_rules! middling {
    ($($int:ty),*) => {$(
        impl Arbitrary for $int {
            fn any() -> Self {
                sixteen() as Self
            }
        }
    )*};
}

middling!(u16, i16);

macro_rules! wide {
    ($($int:ty),*) => {$(
        impl Arbitrary for $int {
            fn any() -> Self {
                wide(Self::BITS) as Self
            }
        }
    )*};
}

wide!(u32, i32, u64, i64, usize, isize, u128, i128);
