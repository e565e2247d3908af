//! Owning a domain's socket: at most one process at a time.
//!
//! A file beside the socket, `<path>.lock`, is locked (`flock(2)`) for as long as the
//! owner lives; the kernel lets go of it when the owner dies, however it dies. Whoever
//! holds the lock may replace what a dead owner left behind. Both files are removed
//! by an owner that ends in an orderly way.
//!
//! Nobody removes or replaces a file here without holding the lock, and a lock counts
//! only while `<path>.lock` names the file that is locked. So it does not matter who
//! removed that file, or left it, or when: there is never more than one owner.

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
pub use self::owned::{DomainSocket, HandOver, NotReclaimed};
pub use self::path::{DEFAULT_DOMAIN, socket_path, socket_path_in};
