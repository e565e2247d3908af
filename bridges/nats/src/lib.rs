//! A bridge between a domain of SM2 and a stream of NATS JetStream.
//!
//! The bridge is an ordinary node of the domain, and an ordinary client of NATS. Each topic that the rules of
//! [`Config`] let out is published below the prefix, and each message of the stream that they let in is published in
//! the domain. Messages are delivered at least once: they are in the files of the spool until the stream has
//! acknowledged them, and in the stream until this bridge has published them.

mod bridge;
mod config;
mod message;
mod stream;

pub use self::bridge::Bridge;
pub use self::config::{Config, ConfigError, ConfigValueError};
pub use sm2_bridge_core::{Account, BridgeError, Counts, SpoolCounts};
