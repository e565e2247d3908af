//! The schema of a message of ROS 2: the RIHS01 hash and the definition of its type.

use alloc::boxed::Box;
use core::fmt;

/// The definition of a message of ROS 2, and the RIHS01 hash that the schema text states for it.
///
/// [`Schema::parse`](super::Schema::parse) checks only the form. A program that decodes messages has
/// to compute the RIHS01 hash of the definition, and to compare it with [`rihs01`](Self::rihs01).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    pub(super) rihs01: [u8; 32],
    pub(super) text: Box<str>,
}

/// The text between `cdr:` and the digits of the hash.
pub(super) const RIHS01: &str = "RIHS01_";

impl Definition {
    /// The RIHS01 hash of the type, as its first line states it.
    #[must_use]
    pub const fn rihs01(&self) -> &[u8; 32] {
        &self.rihs01
    }

    /// The definition, in the form `ros2msg`: lines that each end with a line feed.
    #[must_use]
    pub const fn text(&self) -> &str {
        &self.text
    }
}

impl fmt::Display for Definition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rihs01, text } = self;
        write!(f, "{}\n{text}", Rihs01(rihs01))
    }
}

/// Displays a hash as ROS 2 does.
struct Rihs01<'a>(&'a [u8; 32]);

impl fmt::Display for Rihs01<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(RIHS01)?;
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}
