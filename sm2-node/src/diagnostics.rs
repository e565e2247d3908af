//! What a program and its tools can learn about links: their state, and what they count.
//!
//! [`Publisher::links`](crate::Publisher::links) and its likes return [`LinkStatus`];
//! [`Node::inspect`](crate::Node::inspect) opens the [`CounterView`] of any node of the domain.

pub use sm2_io::CounterView;
pub use sm2_proto::link::{Counters, End};

pub use crate::driver::{LinkStatus, Received};
