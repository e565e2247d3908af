//! The parts that all bridges of SM2 share, whatever network they join a domain to.
//!
//! | part | purpose |
//! | --- | --- |
//! | [`Origin`] | names the bridge, its epoch and the number of a message, so that a message never returns |
//! | [`Duplicates`] | removes the messages that arrive a second time |
//! | [`Spool`] | decides when the messages of durable topics are sent, while the network is away at times |
//! | [`Outbox`] | a spool, and the files of its messages |
//! | [`Member`], [`domain`] | the nodes of a bridge, and the topics of the domain |
//! | [`Inbound`] | publishes the messages of the network in the domain |
//! | [`Account`] | the counts of a bridge, for people and for Prometheus |
//! | [`Shadow`] | the differences that another configuration would make |
//! | [`config`] | the parts of a configuration: the domain, the rules, the spool |
//! | [`program`] | the command line: `run`, `check`, `explain` |
//!
//! Origins, duplicates and the spool are pure: they do no I/O, and time is a value.

mod account;
pub mod config;
pub mod domain;
mod duplicates;
mod durable;
mod error;
mod inbound;
mod incoming;
mod member;
mod origin;
mod outbox;
pub mod program;
mod shadow;
mod spool;
mod store;

pub use self::account::{Account, Counts, ReadAccount};
pub use self::duplicates::{Duplicates, REORDER_MAX};
pub use self::durable::{Durable, publication_time};
pub use self::error::BridgeError;
pub use self::inbound::{Arrival, Ended, Inbound, Payload, Verdict};
pub use self::member::Member;
pub use self::origin::{Delivery, Origin, Origins, WrongOrigin};
pub use self::outbox::Outbox;
pub use self::shadow::Shadow;
pub use self::spool::{Fate, Id, Limits, LimitsError, Output, Spool, SpoolCounts};
pub use self::store::StoreError;
