//! State and counters of links, for programs and tools.
//!
//! [`Publisher::links`](crate::Publisher::links) and the same method of the other interfaces return
//! [`LinkStatus`];
//! [`Node::inspect`](crate::Node::inspect) opens the [`CounterView`] of any node of the domain.

pub use sm2_io::CounterView;
pub use sm2_proto::link::{Counters, End, Fate};

pub use crate::driver::{LinkStatus, Received};
