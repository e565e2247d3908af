//! Lockstep: domain time advances when each member has handled its inputs (SPEC section 16.2).
//!
//! | machine | one for |
//! | --- | --- |
//! | [`Conductor`] | the steps of a replay or a simulation: begins them, and sends turns to the members |
//! | [`Member`] | a node that takes its inputs in lockstep |
//!
//! A member's call and its reply are [`Done`] and [`Turn`]. The states of a member, as both sides see it:
//!
//! | state | input | next state | output |
//! | --- | --- | --- | --- |
//! | free | the service is there | waiting | call: join |
//! | waiting | a legal turn | working | the turn |
//! | waiting | another turn | over | |
//! | waiting | the call failed | free | |
//! | working | finished | waiting | call: done |
//! | working | the service is gone | working | |
//! | over | any | over | |
//!
//! # Rounds
//!
//! In a round, a member handles only messages that were published before the round began, so a fast member cannot
//! change the inputs of a slow one. The conductor names the end of the round before as a moment of `CLOCK_MONOTONIC`
//! (`cut_ns`, SM2-LCK-004): all processes of a host share this clock, and each message has the moment of its
//! publication. A publication is in the queues of all links when the call returns, so no member counts messages, or
//! waits for those of a process that has died.

mod conductor;
mod member;
mod message;

pub use self::{
    conductor::{Conductor, Input, Misuse, Output, Refused, TooManyRounds},
    member::{IllegalTurn, Member, MemberInput, MemberMisuse, MemberOutput},
    message::{Done, Turn},
};
