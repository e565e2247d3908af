//! Texts of configuration files that are not what their keys need.

use alloc::{borrow::ToOwned, string::String};

use crate::{
    Name, NameError,
    gateway::{Pattern, PatternError},
};

/// A text of a configuration file that is not what its key needs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WrongText {
    /// The text is not a name.
    #[error("`{text}`: {source}")]
    Name {
        /// The text.
        text: String,
        /// The rule that it breaks.
        r#source: NameError,
    },
    /// The text is not a pattern of names.
    #[error("`{text}`: {source}")]
    Pattern {
        /// The text.
        text: String,
        /// The rule that it breaks.
        r#source: PatternError,
    },
}

impl WrongText {
    /// Reads a name.
    ///
    /// # Errors
    ///
    /// [`WrongText::Name`].
    pub fn or_name(text: &str) -> Result<Name, Self> {
        Name::new(text).map_err(|source| Self::Name {
            text: text.to_owned(),
            source,
        })
    }

    /// Reads a pattern of names.
    ///
    /// # Errors
    ///
    /// [`WrongText::Pattern`].
    pub fn or_pattern(text: &str) -> Result<Pattern, Self> {
        Pattern::new(text).map_err(|source| Self::Pattern {
            text: text.to_owned(),
            source,
        })
    }
}
