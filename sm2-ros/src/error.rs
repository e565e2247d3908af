//! Errors of decoding the bytes of a message, and of encoding a message.

use std::fmt;

use sm2_ros_idl::SetError;

/// The path of fields and elements to a value, such as `points[3].x`. That of the whole message is shown as `message`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FieldPath(String);

impl FieldPath {
    /// The path to the whole message.
    pub const MESSAGE: Self = Self(String::new());

    /// Puts a step in front: the name of a field, or an element (`[3]`).
    pub fn prepend(&mut self, step: &str) {
        if !self.0.is_empty() && !self.0.starts_with('[') {
            self.0.insert(0, '.');
        }
        self.0.insert_str(0, step);
    }
}

impl fmt::Display for FieldPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match &*self.0 {
            "" => "message",
            path => path,
        })
    }
}

/// Bytes that are not a message of the type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The value at one place is wrong.
    #[error("{path}: {fault}, at byte {at}")]
    Value {
        /// The path of fields to the value.
        path: FieldPath,
        /// The offset from the start of the message, in bytes.
        at: usize,
        /// The fault.
        fault: Fault,
    },
    /// The definition of the type is incomplete.
    #[error(transparent)]
    Set(#[from] SetError),
}

/// The fault of the bytes at one offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The first four bytes are not those of CDR.
    #[error("expected the bytes 00 00 or 00 01 of CDR, followed by two bytes of options")]
    Header,
    /// The message ends inside a value.
    #[error("the message is cut short")]
    Short,
    /// Bytes follow the last value.
    #[error("{0} bytes too many")]
    LeftOver(usize),
    /// A boolean is neither 0 nor 1.
    #[error("{0} is not a boolean")]
    Bool(u8),
    /// A text does not end in a byte 0.
    #[error("a text without a zero at its end")]
    Unterminated,
    /// A text is not UTF-8 or UTF-16.
    #[error("text that is not Unicode")]
    Unicode,
    /// The message has more values than the decoder keeps.
    #[error("more values than are kept; keep fewer elements of each sequence")]
    Values,
    /// A text or sequence is longer than its definition allows.
    #[error("{len} elements, where the definition allows {max}")]
    Limit {
        /// The length in the message.
        len: u32,
        /// The limit of the definition.
        max: u32,
    },
}

impl DecodeError {
    pub(crate) const fn new(at: usize, fault: Fault) -> Self {
        let path = FieldPath::MESSAGE;
        Self::Value { path, at, fault }
    }

    /// Puts a step in front of the path, for an error inside a field or element (`[3]`).
    #[must_use]
    #[cold]
    pub fn within(mut self, step: &str) -> Self {
        if let Self::Value { path, .. } = &mut self {
            path.prepend(step);
        }
        self
    }
}

/// A value that is not a message of the type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The value at one place is wrong.
    #[error("{path}: expected {expected}, found {found}")]
    Value {
        /// The path of fields to the value.
        path: FieldPath,
        /// The expected value.
        expected: String,
        /// The value that was found.
        found: String,
    },
    /// The type has no field of this name.
    #[error("{path}: the type {ty} has no field {field}")]
    Field {
        /// The path of fields to the structure.
        path: FieldPath,
        /// The type of the structure.
        ty: String,
        /// The name.
        field: String,
    },
    /// A text or sequence is longer than its definition allows.
    #[error("{path}: {len} elements, where the definition allows {max}")]
    Limit {
        /// The path of fields to the value.
        path: FieldPath,
        /// The length of the value.
        len: usize,
        /// The limit of the definition, or of CDR.
        max: u32,
    },
    /// The memory for the message does not have the length of the message.
    #[error("the message has {len} bytes, and its memory {room}: use the length of `encoded_len`")]
    Room {
        /// The length of the message, in bytes.
        len: usize,
        /// The length of the memory, in bytes.
        room: usize,
    },
    /// A default value or a missing array needs more than the longest message.
    #[error("{path}: the message would be longer than {max} bytes")]
    TooLong {
        /// The path of fields to the value.
        path: FieldPath,
        /// The limit, in bytes.
        max: usize,
    },
    /// The value lacks more fields and elements than are filled in.
    #[error("{path}: more than {max} values are missing")]
    Missing {
        /// The path of fields to the value.
        path: FieldPath,
        /// The limit.
        max: usize,
    },
    /// The definition of the type is incomplete.
    #[error(transparent)]
    Set(#[from] SetError),
}

impl EncodeError {
    /// Puts a step in front of the path, for an error inside a field or element (`[3]`).
    #[must_use]
    #[cold]
    pub fn within(mut self, step: &str) -> Self {
        match &mut self {
            Self::Value { path, .. }
            | Self::Field { path, .. }
            | Self::Limit { path, .. }
            | Self::Missing { path, .. }
            | Self::TooLong { path, .. } => path.prepend(step),
            Self::Room { .. } | Self::Set(_) => {}
        }
        self
    }
}
