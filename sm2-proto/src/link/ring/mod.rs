//! The ring lane of a link: SPEC section 8.5.
//!
//! A ring is a file of words that both ends map for writing. This module decides which word is
//! written where and judges every word that is read. It reaches the words through [`RingMemory`],
//! three atomic operations and a fence, which the driver lends for the time of a call. Whatever the
//! other end writes there leads to a message, to nothing, or to a violation.
//!
//! A link of a topic has one ring. A link of a service has two: *outgoing* carries the messages that
//! this end sends, *incoming* those that it receives.

mod lane;
mod memory;
mod message;
#[cfg(any(kani, test))]
mod proofs;
mod receiver;
mod segments;
mod sender;
mod waiting;
mod wake;
mod word;

pub(super) use self::{
    lane::RingLane,
    message::{RingMessage, Unsent},
    receiver::{NotTaken, RingReceiver},
    segments::RingSegments,
    sender::RingSender,
    waiting::Waiting,
    wake::wake_parked,
};
pub use self::{
    memory::RingMemory,
    wake::{Wake, doorbell},
    word::{At, EMPTY, NotAWord, RingLayout, SlotHead, Word},
};
