//! Errors of decoding the bytes of a message, and of encoding JSON as a message.

use sm2_proto::{
    schema::{Layout, NoLayout},
    text::Counted,
};
use sm2_ros::{FieldPath, value};

/// Bytes that do not decode as the type that the publisher declared.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DecodeError {
    /// The value at one place.
    #[error("{path}: {wrong}, at byte {at}")]
    Value {
        /// The path of fields to the value.
        path: FieldPath,
        /// The offset in bytes.
        at: usize,
        /// The fault.
        wrong: Wrong,
    },
    /// The length of a plain message does not fit its type.
    #[error(
        "{} cannot be a message of this type, which has {}{}",
        Counted::new(*len as u64, "byte"),
        layout.fixed_bytes,
        layout.element_bytes.map_or(String::new(), |each| format!(" and any multiple of {each}"))
    )]
    Length {
        /// The length that was received.
        len: usize,
        /// The lengths that the type allows.
        layout: Layout,
    },
    /// The schema has a type that its encoding cannot express.
    #[error("its schema is of no plain type: {0}")]
    Layout(NoLayout),
    /// Invalid JSON.
    #[error("invalid JSON: {0}")]
    Json(String),
    /// An encoding that this program does not know.
    #[error("its encoding {0} is not known here")]
    Encoding(Box<str>),
    /// No message of this type of ROS 2.
    #[error(transparent)]
    Ros(#[from] sm2_ros::DecodeError),
}

/// The fault of the bytes at one offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Wrong {
    #[error("the message is cut short")]
    Short,
    #[error("{} too many", Counted::new(*.0 as u64, "byte"))]
    LeftOver(usize),
    #[error("a number beyond its type")]
    Number,
    #[error("{0} is not a boolean")]
    Bool(u8),
    #[error("{0:#x} is not a character")]
    Char(u32),
    #[error("not one character")]
    Chars,
    #[error("text that is not UTF-8")]
    Utf8,
    #[error("{0} says neither that there is a value nor that there is none")]
    Option(u8),
    #[error("there is no variant {0}")]
    Variant(u32),
    #[error("more values than its length justifies")]
    TooMany,
}

impl DecodeError {
    pub(super) const fn new(at: usize, wrong: Wrong) -> Self {
        let path = FieldPath::MESSAGE;
        Self::Value { path, at, wrong }
    }

    /// Whether the message has more values than the decoder keeps.
    pub(super) const fn is_too_many(&self) -> bool {
        matches!(
            self,
            Self::Ros(sm2_ros::DecodeError::Value {
                fault: sm2_ros::Fault::Values,
                ..
            })
        )
    }

    /// Puts a step in front of the path, for an error in a part of the message.
    pub(super) fn within(mut self, step: impl FnOnce() -> String) -> Self {
        if let Self::Value { path, .. } = &mut self {
            path.prepend(&step());
        }
        self
    }
}

/// JSON that cannot be encoded as a message of the type.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum EncodeError {
    /// The value at one place.
    #[error("{path}: {wrong}")]
    Value {
        /// The path of fields to the value.
        path: FieldPath,
        /// The expected value, and the value that was found.
        wrong: String,
    },
    /// The schema has a type that its encoding cannot express.
    #[error("its schema is of no plain type: {0}")]
    Layout(NoLayout),
    /// An encoding that this program does not know.
    #[error("its encoding {0} is not known here: give the message as a file")]
    Encoding(Box<str>),
    /// No message of this type of ROS 2.
    #[error(transparent)]
    Ros(#[from] sm2_ros::EncodeError),
}

impl EncodeError {
    pub(super) const fn new(wrong: String) -> Self {
        let path = FieldPath::MESSAGE;
        Self::Value { path, wrong }
    }

    pub(super) fn expected(what: &str, found: &serde_json::Value) -> Self {
        Self::new(format!("expected {what}, found {}", value::found(found)))
    }

    pub(super) fn within(mut self, step: impl FnOnce() -> String) -> Self {
        if let Self::Value { path, .. } = &mut self {
            path.prepend(&step());
        }
        self
    }
}

/// The step to a field or variant. Control characters of its name are escaped: any node can register a name.
pub(super) fn step(name: &str) -> String {
    name.escape_debug().to_string()
}
