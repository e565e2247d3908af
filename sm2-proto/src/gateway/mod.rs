//! What gateways agree on: SPEC section 14.
//!
//! | part | what it decides |
//! | --- | --- |
//! | [`Rules`] | which names go to which peer, and come from it |
//! | [`Beacon`] | where a peer may be found |
//! | [`schedule::Schedule`] | which message goes to a peer next |

mod beacon;
mod id;
mod pattern;
mod rules;
pub mod schedule;

pub use self::{
    beacon::{BEACON_LEN, Beacon, NoBeacon},
    id::{GatewayId, GatewayIdError},
    pattern::{Pattern, PatternError},
    rules::{Action, Decision, Direction, Rule, Rules, SubjectKind},
};
