//! SM2's protocols as pure state machines, and the frames that they speak.
//!
//! Nothing here does I/O, reads a clock, holds a descriptor or needs std. A driver feeds inputs and
//! carries out outputs; the drivers of this project are in `sm2-manager`, `sm2-node` and `sm2-gateway`.
//! SPEC.md alone defines the protocols: comments that begin with `//=` cite its clauses.
//!
//! | machine | one for |
//! | --- | --- |
//! | [`manager::Manager`] | a domain: its nodes, interfaces and links |
//! | [`node::Node`] | a node's session with its Manager |
//! | [`link::Link`] | one end of a link: topics and services alike |
//! | [`lockstep::Conductor`], [`lockstep::Member`] | the two sides of a lockstep, where domain time advances |
//! | [`gateway::session::PeerSession`] | a gateway's session with a peer |
//! | [`gateway::router::Router`] | the routes of a gateway: which offers it makes, uses and passes on |
//! | [`gateway::discovery::Discovery`] | the peers of a gateway: which one to dial, where and when |
//! | [`gateway::schedule::Schedule`] | the messages that wait for a connection between gateways |
//!
//! The hub and the peer of `sm2-gateway` join these machines and are machines as well.
//!
//! # The contract, the same for all
//!
//! [`Machine`] states it. A driver repeats three steps:
//!
//! 1. `handle(now, input)` takes one input. Time is a value, [`Instant`].
//! 2. `poll()` returns the next output. The driver carries out each output until there is none.
//! 3. `deadline()` is the time when the driver feeds a tick if nothing happens earlier.
//!
//! A received descriptor stays with the driver. The machine sees the kernel's [`FdFacts`] about it,
//! and the driver keeps the descriptor only if an output asks for it. A machine that has ended
//! answers every input with its first reason.
//!
//! # Three kinds of wrong
//!
//! A [`Violation`] is a mistake of the peer: it broke SPEC, and its session or link ends. A
//! *misuse* is a mistake of the driver: nothing was sent and nothing has changed. The driver handles
//! I/O errors; where the protocol has to react, an input reports the error. A [`Refusal`]
//! is none of these: the request was legal, and the session goes on.
//!
//! # Peers are not trusted
//!
//! Decoders yield only values that SPEC allows, and consume all bytes. All memory that a peer can
//! make a machine keep is bounded by [`limits`].
#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::disallowed_types)]

extern crate alloc;

#[macro_use]
mod violation;

mod backoff;
mod clause;
pub mod clock;
mod code;
mod contract;
pub mod control;
pub mod counters;
mod datagram;
pub mod domain;
mod fd;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
pub mod gateway;
mod growing_map;
mod ids;
pub mod limits;
pub mod link;
pub mod lockstep;
mod machine;
pub mod manager;
mod matching;
mod name;
pub mod node;
pub mod policy;
#[cfg(any(kani, test))]
mod proofs;
mod qos;
mod refusal;
pub mod schema;
pub mod text;
mod time;
mod wait_budget;
mod wrong_text;

pub use backoff::Backoff;
pub use clause::Clause;
pub use code::{Code, Farewell, ViolationKind};
pub use contract::{Contract, DemandedQos, Kind, OfferedQos, QosError, ServiceQos, TypeId};
pub use datagram::Datagram;
pub use fd::{FdFacts, Seals};
pub use growing_map::GrowingMap;
pub use ids::{EntityId, InterfaceId, LinkId, LinkKey, NodeId};
pub use machine::{Error, Machine, MisuseError};
pub use matching::{LinkQos, Mismatch, match_contracts};
pub use name::{Name, NameError};
pub use qos::{Newest, Period, QosWatch};
pub use refusal::{Quota, Refusal};
pub use time::Instant;
pub use violation::Violation;
pub use wait_budget::{WaitBudget, WaitGrant};
pub use wrong_text::WrongText;

/// The newest protocol version that this crate speaks (SM2-VER-001).
//= SM2-VER-001
pub const VERSION: u16 = 1;
