//! The numbers of CDR.

use zerocopy::{FromBytes, Immutable, IntoBytes};

use super::Source;

/// A number, whose size in CDR is also its alignment.
pub trait Number:
    Copy + Default + std::fmt::Debug + FromBytes + IntoBytes + Immutable + private::Sealed + 'static
{
    /// Converts a number whose bytes are in this order to the order of this machine, or back.
    #[must_use]
    fn in_order(self, big_endian: bool) -> Self;

    /// Converts all numbers of a slice.
    #[inline]
    fn all_in_order(numbers: &mut [Self], big_endian: bool) {
        if big_endian != cfg!(target_endian = "big") {
            for number in numbers {
                *number = number.in_order(big_endian);
            }
        }
    }

    /// Copies `len` numbers as they are; `None` if they are not all inside.
    #[inline]
    fn copy_all<S: Source>(source: &S, at: usize, len: usize) -> Option<Vec<Self>> {
        let mut numbers = vec![Self::default(); len];
        let is_inside = source.copy_to(at, numbers.as_mut_bytes());
        is_inside.then_some(numbers)
    }
}

mod private {
    /// So that only this file implements `Number`.
    pub trait Sealed {}
}

macro_rules! integers {
    ($($type:ty),*) => {
        $(
            impl private::Sealed for $type {}

            impl Number for $type {
                #[inline]
                fn in_order(self, big_endian: bool) -> Self {
                    match big_endian {
                        true => Self::from_be(self),
                        false => Self::from_le(self),
                    }
                }
            }
        )*
    };
}

integers!(i8, u16, i16, u32, i32, u64, i64);

macro_rules! floats {
    ($($type:ty),*) => {
        $(
            impl private::Sealed for $type {}

            impl Number for $type {
                #[inline]
                fn in_order(self, big_endian: bool) -> Self {
                    Self::from_bits(self.to_bits().in_order(big_endian))
                }
            }
        )*
    };
}

floats!(f32, f64);

impl private::Sealed for u8 {}

impl Number for u8 {
    #[inline]
    fn in_order(self, _: bool) -> Self {
        self
    }

    /// Images have millions of them, which need no zeroes first.
    fn copy_all<S: Source>(source: &S, at: usize, len: usize) -> Option<Vec<Self>> {
        source.to_vec(at, len)
    }
}
