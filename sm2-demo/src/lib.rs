//! The two demos of SM2.
//!
//! | demo | function |
//! | --- | --- |
//! | one domain: a publisher and several subscribers, each a process, check every byte | [`one_domain::run`] |
//! | two domains: two gateways with a lossy link between them | [`two_domains::run`] |
//!
//! Both take [`Options`], write to any writer, and end early when a descriptor becomes readable. They need no
//! Manager: they start their own. [`one_domain`] starts the current program again for each process, with
//! [`COMMAND`] as the first argument: the program passes the arguments to [`one_domain::process::run`].
#![forbid(unsafe_code)]

mod error;
mod folder;
pub mod one_domain;
mod options;
mod output;
mod pattern;
mod process_cost;
mod statistics;
pub mod two_domains;
mod waiting;

pub use self::{
    error::DemoError,
    one_domain::command_line::{COMMAND, ProcessArguments},
    options::{Ending, Format, Options, SIZE_MIN_BYTES},
};
