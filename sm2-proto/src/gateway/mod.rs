//! What gateways agree on: SPEC section 14.
//!
//! | part | what it is about |
//! | --- | --- |
//! | [`Rules`] | which names go to which peer, and come from it |
//! | [`Beacon`], [`discovery::Discovery`] | where a peer may be found, whom to connect to and when |
//! | [`Frame`], [`FrameReader`] | what gateways say to each other |
//! | [`Header`] | what stands before a payload |
//! | [`session::Session`] | one connection with a peer |
//! | [`router::Router`] | which offers are made, used and passed on |
//! | [`schedule::Schedule`] | which message goes to a peer next |

mod beacon;
mod code;
pub mod discovery;
mod frames;
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) mod fuzz;
mod header;
mod id;
mod pattern;
pub mod router;
mod rules;
pub mod schedule;
pub mod session;

pub use self::{
    beacon::{BEACON_LEN, Beacon, BeaconError},
    code::{PeerFarewell, PeerViolation, PeerViolationKind, StreamEnd},
    frames::{Frame, FrameReader, Hop, Subject, Verdict},
    header::{Carried, HEADER_LEN, Header, Outcome},
    id::{AskId, GatewayId, GatewayIdError, OfferId, StreamToken},
    pattern::{Pattern, PatternError},
    rules::{Action, Decision, Direction, Rule, Rules, SubjectKind},
};
