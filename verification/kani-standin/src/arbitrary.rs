//! Values of any content.

use crate::runner::{assume, choose, wide};

/// A type that [`any`] can make.
pub trait Arbitrary: Sized {
    /// Any value of the type.
    fn any() -> Self;
}

/// Any value.
#[must_use]
pub fn any<T: Arbitrary>() -> T {
    T::any()
}

/// Any value for which `holds`.
pub fn any_where<T: Arbitrary>(holds: impl FnOnce(&T) -> bool) -> T {
    let value = T::any();
    assume(holds(&value));
    value
}

impl Arbitrary for bool {
    fn any() -> Self {
        choose(2) == 1
    }
}

macro_rules! narrow {
    ($($int:ty: $values:literal),*) => {$(
        impl Arbitrary for $int {
            fn any() -> Self {
                choose($values) as Self
            }
        }
    )*};
}

narrow!(u8: 256, i8: 256, u16: 65_536, i16: 65_536);

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

impl<T: Arbitrary, const N: usize> Arbitrary for [T; N] {
    fn any() -> Self {
        std::array::from_fn(|_| T::any())
    }
}

impl<T: Arbitrary> Arbitrary for Option<T> {
    fn any() -> Self {
        bool::any().then(T::any)
    }
}

impl<A: Arbitrary, B: Arbitrary> Arbitrary for (A, B) {
    fn any() -> Self {
        (A::any(), B::any())
    }
}

impl<A: Arbitrary, B: Arbitrary, C: Arbitrary> Arbitrary for (A, B, C) {
    fn any() -> Self {
        (A::any(), B::any(), C::any())
    }
}
