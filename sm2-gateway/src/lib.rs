//! SM2 gateways: topics and services between domains, over QUIC (SPEC section 14).
//!
//! | to do | see |
//! | --- | --- |
//! | run a gateway in a program | [`Config`], [`Gateway`] |
//! | generate and read keys | [`keys`] |
//! | request reports from the gateways of a domain | [`report`] |
//! | ask whether a peer offers a topic or service | [`availability`] |
//! | compare rules with other rules | [`shadow`] |
//! | read rules in the configuration of another program | [`rule_words`] |
//! | export metrics to Prometheus | `metrics`, with the feature of that name |
//! | drive one connection in a loop of your own, or in a simulation | [`peer`] |
//! | drive the routes and calls between domain and peers likewise | [`hub`] |
//! | run gateways over a lossy link | the unpublished crate `sm2-lossy-link` |
//!
//! From the bottom up: the machines of `sm2_proto::gateway` decide; [`peer`] and [`hub`] combine them
//! without I/O; `channel` has the queues between tasks, `local` the nodes in the domain, `run` the tasks,
//! and `program` the command line.

#![deny(clippy::disallowed_types)]

mod address;
pub mod availability;
mod channel;
pub mod clock;
pub mod config;
mod domain;
pub mod hub;
pub mod keys;
mod local;
mod message;
#[cfg(feature = "metrics")]
pub mod metrics;
mod names;
pub mod peer;
#[cfg(feature = "program")]
pub mod program;
pub mod report;
mod retry;
pub mod rule_words;
mod run;
pub mod shadow;
mod tally;

pub use self::{
    address::{Address, AddressError},
    config::{Config, ConfigError, ConfigValueError},
    domain::DomainLocation,
    local::LocalError,
    names::{is_remote, status_service},
    report::{PeerReport, Report},
    run::{BeaconsError, Gateway, RunError},
    tally::Counts,
};
