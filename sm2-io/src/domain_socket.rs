//! The socket of a domain: where it is, and owning it. At most one process owns it at a time.
//!
//! The owner holds a lock (`flock(2)`) on a file beside the socket, `<path>.lock`. The kernel releases
//! the lock when the owner dies. The holder of the lock may replace the files that a dead owner left
//! behind. An owner that exits cleanly removes both files.
//!
//! A process removes or replaces a file only while it holds the lock, and a lock counts only while
//! `<path>.lock` names the locked file. So there is never more than one owner, whichever process
//! removed or left that file.

mod bind;
mod error;
mod files;
mod limits;
mod lock;
mod owned;
mod path;
mod socket_file;

pub use self::bind::BindOptions;
pub use self::error::DomainSocketError;
pub use self::limits::{MAX_DOMAIN_BYTES, MAX_PATH_BYTES};
pub use self::lock::DomainLock;
pub use self::owned::{DomainSocket, NotReclaimed, UnlockedSocket};
pub use self::path::{DEFAULT_DOMAIN, socket_path, socket_path_in};
