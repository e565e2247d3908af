//! Parameters of a node: values that other nodes and people can read, watch and set while a program runs.
//!
//! ```no_run
//! use sm2_node::Node;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::new("lidar")?;
//! let mut builder = node.parameters_builder();
//! let max_range = builder
//!     .parameter("max_range", 30.0)
//!     .range(0.5..=100.0)
//!     .description("the greatest distance that is published, in metres")
//!     .add();
//! let _parameters = builder.declare()?;
//! loop {
//!     println!("scanning up to {} m", max_range.get()); // `sm2 param set lidar max_range 12.5` changes it
//!     std::thread::sleep(std::time::Duration::from_secs(1));
//! }
//! # }
//! ```
//!
//! # Values
//!
//! A value has one of the nine types of [`Value`], those of ROS 2. It comes from the first of these places that has
//! one:
//!
//! 1. a set while the program runs: by `sm2 param set`, another node, or [`Parameters::set`];
//! 2. the environment variable `SM2_PARAM_NAME`, where NAME is the parameter's name in upper case with `_` for each `.`
//!    and `-`;
//! 3. a [file](File) of [`ParametersBuilder::files`], the last one first;
//! 4. the file that the environment variable `SM2_PARAMS` names;
//! 5. the program's default.
//!
//! A value of the wrong type or outside of the range is an error of [`declare`](ParametersBuilder::declare), which
//! names the file and the line, and the parameter. So is a name in the table of the node that is none of its
//! parameters.
//!
//! # Changes
//!
//! After [`declare`](ParametersBuilder::declare), a thread of the library accepts all changes that types and ranges
//! allow. After [`declare_with_changes`](ParametersBuilder::declare_with_changes), the program decides about each of
//! them:
//!
//! ```no_run
//! # use sm2_node::Node;
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let node = Node::new("lidar")?;
//! let mut builder = node.parameters_builder();
//! let min = builder.parameter("min", 1.0).add();
//! let max = builder.parameter("max", 9.0).add();
//! let (_parameters, changes) = builder.declare_with_changes()?;
//! loop {
//!     let change = changes.next()?; // or in a wait set, or an executor
//!     if change.get(&min) < change.get(&max) {
//!         change.accept();
//!     } else {
//!         change.refuse("min has to be less than max");
//!     }
//! }
//! # }
//! ```
//!
//! A request sets all of its parameters or none. [`Parameters::snapshot`] shows them as a whole.
//!
//! # How other nodes see them
//!
//! The parameters of the node NODE are the latched topic `parameters/NODE`, whose message is a [`Table`] of all of
//! them; the library publishes a new one after each change. The service `parameters/NODE` sets them:
//! [`SetParameters`], [`SetParametersResult`]. The node's background thread answers readers, so reading needs no help
//! of the program. A set waits for a program that handles its changes itself, until the time limit of the client. The
//! access policy rules them as any topic and service: the right to *subscribe* is that to read, and the right to *call*
//! is that to set. SPEC, Annex D, has the rules for ports.

mod builder;
mod changes;
mod core;
mod environment;
mod error;
mod file;
pub mod limits;
mod notation;
mod parameters;
mod range;
mod refusal;
mod resolve;
mod table;
mod topic;
mod value;

pub use self::builder::{ParameterBuilder, ParametersBuilder};
pub use self::changes::{Change, Changes};
pub use self::core::{Parameter, Snapshot};
pub use self::environment::{FILE_VARIABLE, variable};
pub use self::error::{ParametersError, SetError};
pub use self::file::{ALL_NODES, File, FileError, FileValue};
pub use self::notation::WrongValue;
pub use self::parameters::Parameters;
pub use self::range::Range;
pub use self::refusal::{NameProblem, Refusal, WrongTable};
pub use self::table::{Assignment, Entry, Origin, SetParameters, SetParametersResult, Table};
pub use self::topic::{name, node_of};
pub use self::value::{Kind, ParameterType, Value};

#[cfg(test)]
mod tests;
