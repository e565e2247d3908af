//! The form of a structure in JSON and for people.

use sm2_proto::schema::{Field, Type};

/// How a structure is shown, to people and in JSON.
pub(super) enum Shape<'a> {
    /// A structure without fields.
    Unit,
    /// The value of its only, nameless field.
    Single(&'a Type),
    /// Values without names.
    Tuple,
    /// Values with names.
    Named,
}

impl<'a> Shape<'a> {
    pub(super) fn of(fields: &'a [Field]) -> Self {
        let mut numbered = fields.iter().enumerate();
        match fields {
            [] => Self::Unit,
            [only] if only.name() == "0" => Self::Single(only.ty()),
            _ if numbered.all(|(at, field)| field.name() == at.to_string()) => Self::Tuple,
            _ => Self::Named,
        }
    }
}
