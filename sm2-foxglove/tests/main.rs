//! The server, with nodes of a domain on one side and a viewer on the other.
//!
//! The viewer reads and writes messages with the crate `foxglove`, Foxglove's own implementation of the protocol.

mod access;
mod back_pressure;
mod channels;
mod common;
mod foxglove_schemas;
mod program;
mod publishing;
mod services;
mod time;
