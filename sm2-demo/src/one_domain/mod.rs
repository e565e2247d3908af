//! One domain: one process publishes, several receive and check every byte; the Manager is in the demo's own
//! process.
//!
//! `director` starts, watches and ends the processes; `publisher` and `subscriber` are their roles; `part` is the
//! protocol between a process and its director.

mod child;
pub(crate) mod command_line;
mod director;
mod meter;
mod part;
pub mod process;
mod publisher;
pub(crate) mod report;
mod screen;
mod subscriber;
mod table;

pub use self::director::run;
