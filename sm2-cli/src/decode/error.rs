//! Errors of decoding the bytes of a message, and of encoding JSON as a message.

use sm2_proto::{
    schema::{Layout, NoLayout},
    text::Counted,
};

/// Bytes that do not decode as the type that the publisher declared.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DecodeError {
    /// The value at one place.
    #[error("{}: {wrong}, at byte {at}", name_of(path))]
    Value {
        /// The fields that lead there, each with the `.` or `[]` before it.
        path: String,
        /// Where, in bytes.
        at: usize,
        /// What is wrong.
        wrong: Wrong,
    },
    /// The whole plain message.
    #[error(
        "{} cannot be a message of this type, which has {}{}",
        Counted::new(*len as u64, "byte"),
        layout.fixed_bytes,
        layout.element_bytes.map_or(String::new(), |each| format!(" and any multiple of {each}"))
    )]
    Length {
        /// How many came.
        len: usize,
        /// How many would be right.
        layout: Layout,
    },
    /// The schema and its encoding do not go together.
    #[error("its schema is of no plain type: {0}")]
    Layout(#[from] NoLayout),
    /// JSON that is none.
    #[error("no JSON: {0}")]
    Json(String),
    /// Not one that this program knows.
    #[error("its encoding {0} is not known here")]
    Encoding(Box<str>),
}

/// What is wrong with the bytes at one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Wrong {
    #[error("the message is cut short")]
    Short,
    #[error("{} too many", Counted::new(*.0 as u64, "byte"))]
    LeftOver(usize),
    #[error("a number beyond its type")]
    Number,
    #[error("{0} is no boolean")]
    Bool(u8),
    #[error("{0:#x} is no character")]
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
        let path = String::new();
        Self::Value { path, at, wrong }
    }

    /// The same error, as one of a part of the message.
    pub(super) fn within(mut self, step: impl FnOnce() -> String) -> Self {
        if let Self::Value { path, .. } = &mut self {
            path.insert_str(0, &step());
        }
        self
    }
}

/// What a person gave for a message and the type does not take.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum EncodeError {
    /// The value at one place.
    #[error("{}: {wrong}", name_of(path))]
    Value {
        /// As in [`DecodeError::Value`].
        path: String,
        /// What is wrong, and what would be right.
        wrong: String,
    },
    /// The schema and its encoding do not go together.
    #[error("its schema is of no plain type: {0}")]
    Layout(#[from] NoLayout),
    /// Not one that this program knows.
    #[error("its encoding {0} is not known here: give the message as a file")]
    Encoding(Box<str>),
}

impl EncodeError {
    pub(super) const fn new(wrong: String) -> Self {
        let path = String::new();
        Self::Value { path, wrong }
    }

    pub(super) fn expected(what: &str, found: &serde_json::Value) -> Self {
        let found = match found {
            serde_json::Value::Array(_) => "an array".to_owned(),
            serde_json::Value::Object(_) => "an object".to_owned(),
            scalar => brief(&scalar.to_string()),
        };
        Self::new(format!("expected {what}, found {found}"))
    }

    pub(super) fn within(mut self, step: impl FnOnce() -> String) -> Self {
        if let Self::Value { path, .. } = &mut self {
            path.insert_str(0, &step());
        }
        self
    }
}

/// What somebody gave, which may be long.
fn brief(text: &str) -> String {
    const CHARS: usize = 40;
    match text.char_indices().nth(CHARS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// The step to a field or variant: its name is whatever somebody registered.
pub(super) fn step(name: &str) -> String {
    format!(".{}", name.escape_debug())
}

fn name_of(path: &str) -> String {
    match path.strip_prefix('.').unwrap_or(path) {
        "" => "message".to_owned(),
        path => path.to_owned(),
    }
}
