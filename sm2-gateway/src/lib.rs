//! SM2 gateways: topics and services between domains, over QUIC (SPEC section 14).
//!
//! | to do | see |
//! | --- | --- |
//! | run one in a program | [`Config`], [`Gateway`] |
//! | make and read keys | [`keys`] |
//! | ask those of a domain how they are | [`report`] |
//! | ask whether a peer could give something | [`question`] |
//! | compare rules with others | [`shadow`] |
//! | count for Prometheus | `metrics`, with the feature of that name |
//! | drive one connection in a loop of your own, or in a simulation | [`peer`] |
//! | the same for all that is between domain and peers | [`hub`] |
//! | try all that over a link that loses, delays and stands still | the unpublished crate `sm2-lossy-link` |
//!
//! What is decided is decided by the machines of `sm2_proto::gateway`; [`peer`] and [`hub`] join them
//! without I/O; `run` has the tasks, `local` the domain's nodes.

mod address;
mod channel;
pub mod clock;
pub mod config;
mod domain;
pub mod hub;
pub mod keys;
mod local;
#[cfg(feature = "metrics")]
pub mod metrics;
mod names;
pub mod peer;
#[cfg(feature = "program")]
pub mod program;
pub mod question;
pub mod report;
mod run;
pub mod shadow;
mod tally;

pub use self::{
    address::{Address, AddressError},
    config::{Config, ConfigError, ValueError},
    domain::DomainLocation,
    local::LocalError,
    names::{is_remote, status_service},
    report::{PeerReport, Report},
    run::{BeaconsError, Gateway, RunError},
    tally::Counts,
};
