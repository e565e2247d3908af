//! The protocols between gateways: SPEC section 14. Annex B.10 to B.14 has their procedures.
//!
//! | part | purpose |
//! | --- | --- |
//! | [`Rules`], [`Pattern`] | decide which names may pass to and from which peer |
//! | [`Frame`], [`FrameReader`] | the frames of the control stream |
//! | [`Header`] | the header before the payload of a message, a request or a reply |
//! | [`Beacon`] | the datagram that lets gateways find each other |
//! | [`session::PeerSession`] | the machine of one connection with a peer |
//! | [`router::Router`] | the machine that decides which offers are made, used and passed on |
//! | [`schedule::Schedule`] | the machine that decides which message goes to a peer next |
//! | [`discovery::Discovery`] | the machine that decides which peer is dialled, where and when |
//!
//! A stream of QUIC is named by a [`StreamToken`] of the driver; payloads stay with the driver.

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
    header::{HEADER_LEN, Header, HeaderKind, Outcome},
    id::{AskId, GatewayId, GatewayIdError, OfferId, StreamToken},
    pattern::{Pattern, PatternError},
    rules::{Action, Decision, Direction, Rule, Rules, SubjectKind},
};
