//! SM2 wire formats and sans-IO state machines.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod code;
mod contract;
pub mod control;
mod datagram;
mod fd;
mod ids;
pub mod limits;
pub mod manager;
mod matching;
mod name;
pub mod node;
mod refusal;
mod time;

pub use code::{Code, Farewell, Violation};
pub use contract::{Contract, Demand, Kind, Offer, QosError, ServiceQos, TypeId};
pub use datagram::Datagram;
pub use fd::{FdFacts, Seals};
pub use ids::{InterfaceId, LinkId, NodeId};
pub use matching::{Mismatch, Terms, match_contracts};
pub use name::{Name, NameError};
pub use refusal::{Quota, Refusal};
pub use time::Instant;

/// The newest protocol version that this crate speaks (SM2-VER-001).
//= SM2-VER-001
pub const VERSION: u16 = 1;
