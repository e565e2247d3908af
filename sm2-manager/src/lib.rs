//! The broker of an SM2 domain: it knows the nodes and links their interfaces. It never sees a message.
//!
//! This crate is the thin driver around [`sm2_proto::manager::Manager`]: it accepts connections, moves
//! datagrams, creates the socket pairs of links, and closes connections when the machine says so. All rules
//! are in the machine.
//!
//! - [`Manager`]: claims a domain's socket and serves it on the calling thread.
//! - [`Standby`]: waits while another Manager serves the domain, then serves it.
//! - [`Background`]: runs either of them on its own thread, for programs that embed a Manager.
//! - `program` (feature `program`, on by default): the command line that `sm2-manager` and `sm2 manager`
//!   share.
//!
//! ```no_run
//! let path = sm2_io::socket_path(None)?;
//! let manager = sm2_manager::Background::start(&path, sm2_manager::Options::default())?;
//! // … nodes connect to `path` …
//! manager.stop()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # When a Manager ends
//!
//! | cause | effect on the domain |
//! | --- | --- |
//! | the process is killed or crashes | a standby serves once the kernel has freed the lock, else the next Manager |
//! | [`Stopper::stop`], SIGTERM | the Manager says goodbye and removes the socket; then as above |
//! | [`HandOver::start`], SIGUSR2 | the next Manager serves before this one says goodbye |
//!
//! In each case links stay open, and nodes reconnect by themselves (SPEC, section 11).
#![forbid(unsafe_code)]
#![deny(clippy::disallowed_types)]

mod background;
mod connection;
mod driver;
mod handles;
mod options;
mod policy_file;
#[cfg(feature = "program")]
pub mod program;
mod standby;

pub use background::Background;
pub use driver::Manager;
pub use handles::{HandOver, PolicyReloader, Stopper};
pub use options::{Options, Outcome, RunError, StartError};
pub use policy_file::{PolicyFile, PolicyFileError, PolicyValueError, PolicyWarning};
pub use sm2_proto::control::{Limit, LimitError, Limits};
pub use standby::{Role, Standby};
