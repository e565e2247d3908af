//! The messages of the service `lockstep`.

use sm2_proto::Instant;
use sm2_proto::clock::DomainTime;
use sm2_proto::lockstep::{Done, Turn};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::Message;

/// The name of the service.
pub const SERVICE: &str = "lockstep";

/// A call of a member.
#[derive(Clone, Copy, Debug, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sm2/LockstepDone")]
#[repr(C)]
pub struct LockstepDone {
    step: u64,
    round: u64,
    taken: u64,
    next_ns: u64,
}

impl From<Done> for LockstepDone {
    fn from(done: Done) -> Self {
        Self {
            step: done.step,
            round: done.round,
            taken: done.taken,
            next_ns: done.next.map_or(u64::MAX, |it| it.0),
        }
    }
}

impl From<LockstepDone> for Done {
    fn from(message: LockstepDone) -> Self {
        Self {
            step: message.step,
            round: message.round,
            taken: message.taken,
            next: (message.next_ns != u64::MAX).then_some(DomainTime(message.next_ns)),
        }
    }
}

/// The reply to it.
#[derive(Clone, Copy, Debug, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sm2/LockstepTurn")]
#[repr(C)]
pub struct LockstepTurn {
    step: u64,
    round: u64,
    time_ns: u64,
    cut_ns: u64,
}

impl From<Turn> for LockstepTurn {
    fn from(turn: Turn) -> Self {
        Self {
            step: turn.step,
            round: turn.round,
            time_ns: turn.time.0,
            cut_ns: turn.cut.0,
        }
    }
}

impl From<LockstepTurn> for Turn {
    fn from(message: LockstepTurn) -> Self {
        Self {
            step: message.step,
            round: message.round,
            time: DomainTime(message.time_ns),
            cut: Instant(message.cut_ns),
        }
    }
}
