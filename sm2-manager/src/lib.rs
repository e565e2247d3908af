//! The broker of an SM2 domain: who is there, and who talks to whom. Never on the data path.
//!
//! This crate is the thin driver around [`sm2_proto::manager::Manager`]: it accepts
//! connections, moves datagrams, makes the socket pairs of links, and hangs up where the
//! machine says so. All rules live in the machine.
//!
//! - [`Manager`]: claims a domain's socket and serves it on the calling thread.
//! - [`Background`]: the same on a thread of its own, for programs that embed a Manager.
//! - [`program`]: the command line that `sm2-manager` and `sm2 manager` share.
//!
//! ```no_run
//! let path = sm2_io::socket_path(None)?;
//! let manager = sm2_manager::Background::start(&path, sm2_manager::Options::default())?;
//! // … nodes connect to `path` …
//! manager.stop()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod background;
mod connection;
mod driver;
pub mod program;

pub use background::Background;
pub use driver::{Manager, Options, RunError, StartError, Stopper};
pub use sm2_proto::manager::Policy;
