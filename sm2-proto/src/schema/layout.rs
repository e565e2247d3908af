//! The positions of values in a plain message.

use super::{Field, Type};
use crate::limits::MESSAGE_MAX;

/// The number of bytes that a plain value takes.
///
/// Plain values have no padding (SPEC Annex A), so each begins where the one before it ends. Their
/// alignment is not known: `u32` stands for numbers with and without one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// The size of the fixed part, at most [`MESSAGE_MAX`].
    pub fixed_bytes: u64,
    /// The size of an element of the list at the end, at least 1; `None` without a list.
    pub element_bytes: Option<u64>,
}

/// The reason why a type has no plain layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoLayout {
    /// Only an encoding can express the type.
    #[error("plain messages hold numbers, booleans, characters, arrays and structures only")]
    Kind,
    /// A list in a list, or before another field.
    #[error("a list is followed by something whose place would depend on it")]
    ListNotLast,
    /// A list whose length does not follow from its size.
    #[error("the elements of a list take no bytes")]
    EmptyElement,
    /// Longer than any message.
    #[error("it is longer than any message")]
    TooLong,
}

impl Layout {
    /// The layout of a type.
    ///
    /// # Errors
    ///
    /// [`NoLayout`] if values of this type are never plain.
    pub fn of(ty: &Type) -> Result<Self, NoLayout> {
        match ty {
            Type::Scalar(scalar) => Ok(Self::fixed(scalar.size_bytes())),
            Type::Struct(fields) => Self::of_fields(fields),
            Type::Array { element, len } => {
                let each = Self::size_of(element)?;
                each.checked_mul(*len)
                    .filter(|bytes| *bytes <= MESSAGE_MAX)
                    .map(Self::fixed)
                    .ok_or(NoLayout::TooLong)
            }
            Type::List(element) => match Self::size_of(element)? {
                0 => Err(NoLayout::EmptyElement),
                each => Ok(Self {
                    fixed_bytes: 0,
                    element_bytes: Some(each),
                }),
            },
            Type::Text | Type::Enum(_) | Type::Set(_) | Type::Map { .. } | Type::Option(_) => {
                Err(NoLayout::Kind)
            }
        }
    }

    /// The number of elements in the list at the end of a value of this many bytes; 0 if there is
    /// no list. `None` if no value has this size.
    #[must_use]
    pub fn elements(&self, bytes: u64) -> Option<u64> {
        let rest = bytes.checked_sub(self.fixed_bytes)?;
        match self.element_bytes {
            Some(each) => (rest % each == 0).then(|| rest / each),
            None => (rest == 0).then_some(0),
        }
    }

    /// The size of a type whose values all have the same size.
    ///
    /// # Errors
    ///
    /// [`NoLayout`] if their sizes differ.
    pub fn size_of(ty: &Type) -> Result<u64, NoLayout> {
        let layout = Self::of(ty)?;
        match layout.element_bytes {
            Some(_) => Err(NoLayout::ListNotLast),
            None => Ok(layout.fixed_bytes),
        }
    }

    fn of_fields(fields: &[Field]) -> Result<Self, NoLayout> {
        fields.iter().try_fold(Self::fixed(0), |before, field| {
            let this = Self::of(field.ty())?;
            if before.element_bytes.is_some() {
                return Err(NoLayout::ListNotLast);
            }
            // Both are at most MESSAGE_MAX, so the sum does not overflow.
            let fixed_bytes = before.fixed_bytes + this.fixed_bytes;
            if fixed_bytes > MESSAGE_MAX {
                return Err(NoLayout::TooLong);
            }
            Ok(Self {
                fixed_bytes,
                ..this
            })
        })
    }

    const fn fixed(fixed_bytes: u64) -> Self {
        Self {
            fixed_bytes,
            element_bytes: None,
        }
    }
}
