//! A schema, as a tree of kinds of values.

/// A schema of Foxglove.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct FoxgloveSchema {
    /// The name, such as `foxglove.LaserScan`.
    pub(crate) name: &'static str,
    pub(super) root: Kind,
}

/// The kind of a value.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Text,
    Number,
    /// A whole number; the number of a constant in an enumeration.
    Integer,
    Boolean,
    Bytes,
    Object(&'static [Field]),
    List {
        element: &'static Kind,
        /// `None` for any number of elements.
        len: Option<u64>,
    },
}

/// A field of an object.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    pub(super) is_optional: bool,
}
