//! Shared mappings of memfds, and private memory.
//!
//! # What a reader may rely on
//!
//! Memory that another process can change is not what Rust means by `&[u8]`.
//! So it matters what was mapped, and whoever maps must have asked for
//! [`facts`](crate::memfd::facts) and let the protocol judge them first:
//!
//! - A *sealed* memfd (`SHRINK|GROW|WRITE`) is immutable for everybody, its
//!   author included. A reference into it is as good as one into private memory.
//! - A *pooled* one (`SHRINK|GROW|FUTURE_WRITE`) never faults, and nobody but
//!   its author can write. The author must not write to a slot that is
//!   lent out; one that does so breaks the specification, and readers see bytes
//!   change. They must copy what they decide on before they check it, and
//!   read in place only what is valid for every bit pattern. Whoever cannot
//!   trust the author demands sealed messages.
//! - A file without `SHRINK` can be cut short by its author, and reading past
//!   its new end kills the reader (`SIGBUS`). Never map such a file.

mod read_only;
mod region;
mod scratch;
pub(crate) mod writable;

pub use self::read_only::Mapping;
pub use self::scratch::Scratch;
