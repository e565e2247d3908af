//! Shared mappings of memfds, and private memory.
//!
//! # What a reader may rely on
//!
//! Memory that another process can change is not what Rust means by `&[u8]`, and memory that
//! another process can shrink kills its reader (`SIGBUS`). So each kind of mapping takes the
//! [proof](crate::memfd::verify) that it needs, and offers no more than that proof allows:
//!
//! - [`SealedMapping`]: the file is immutable for all processes, so its bytes are a slice.
//! - [`PooledMapping`]: the file keeps its size, but its author writes to it. The bytes come as
//!   copies, or as a raw pointer for a caller that knows when the author does not write.
//!
//! A file without the seal `SHRINK` cannot be mapped at all.

mod read_only;
mod region;
mod scratch;
pub(crate) mod writable;

pub use self::read_only::{PooledMapping, SealedMapping, copy_from_range, copy_range, part_of};
pub use self::scratch::Scratch;
