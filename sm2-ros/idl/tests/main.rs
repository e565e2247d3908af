//! The integration tests of the definitions.
//!
//! One program: its tests share one build and one link.

mod comments;
mod folders;
mod hashes;
mod lines;
mod texts;
