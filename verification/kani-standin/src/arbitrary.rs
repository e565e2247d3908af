//! Values of any content.

use crate::runner::{assume, choose, choose_where, sixteen, wide};

/// A type that [`any`] can make.
pub trait Arbitrary: Sized {
    /// Any value of the type.
    fn any() -> Self;

    /// Any value for which `holds` returns true. If there are few values, only such values are tried.
    fn any_where(holds: impl Fn(&Self) -> bool) -> Self {
        let value = Self::any();
        assume(holds(&value));
        value
    }
}

/// Any value.
#[must_use]
pub fn any<T: Arbitrary>() -> T {
    T::any()
}

/// Any value for which `holds`, which says the same whenever it is asked.
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
