//! Shows the topics and services of a domain of SM2 in Foxglove: a server of the Foxglove WebSocket protocol.
//!
//! [`Server`] is a node of the domain like any other. It has the topics of the domain as *channels*, which follow the
//! domain, and subscribes to a topic only while a viewer looks at it. [`program`] is the command line.
//!
//! | module | purpose |
//! | --- | --- |
//! | `server` | accepts viewers, and follows the domain |
//! | `catalogue` | the channels and services of the domain; `graph` is the connection graph |
//! | `viewer` | one viewer: its subscriptions, calls and publications, in a thread of its own |
//! | `outbox` | the messages that wait for one viewer, their order and their budget |
//! | `connection`, `frame`, `protocol` | the WebSocket protocol, and the messages of Foxglove in it |
//! | `message_type`, `json_schema`, `foxglove_schema` | the forms of messages and of their schemas |
//! | `access` | decides which connections are accepted |

mod access;
mod catalogue;
mod connection;
mod foxglove_schema;
mod frame;
mod graph;
mod json_schema;
mod message_type;
mod news;
mod options;
mod outbox;
pub mod program;
mod protocol;
mod server;
mod shared;
mod viewer;

pub use crate::options::Options;
pub use crate::server::{Server, ServerError};
