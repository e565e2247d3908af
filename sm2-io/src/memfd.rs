//! Memory files (`memfd_create(2)`): making, sealing and verifying them.

mod blame;
mod copy;
mod facts;
pub(crate) mod file;
mod loan;
mod preallocated;
mod sealed;
mod segment;
pub mod verify;

pub use self::blame::{Side, blame};
pub use self::copy::sealed_from_parts;
pub use self::facts::{facts, read_exact_at};
pub use self::file::locked_bytes_max;
pub use self::loan::SealedLoan;
pub use self::preallocated::Preallocated;
pub use self::sealed::sealed_from_bytes;
pub use self::segment::Segment;
pub use self::verify::{InspectedFd, PooledFile, RingFile, SealedFile, VerifyError};
pub use crate::huge::{huge_pages_allowed, huge_pages_allowed_by};
