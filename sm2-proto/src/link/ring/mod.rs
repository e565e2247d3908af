//! The ring lane of a link: SPEC section 8.5.
//!
//! A ring is a file of words that both ends map for writing. This module decides which word is
//! written at which index, and checks every word that is read. It accesses the words through
//! [`RingMemory`], which the driver lends for one call. Every word that the other end can write
//! leads to a message, to no message, or to a violation.
//!
//! A link of a topic has one ring. A link of a service has two: the *outgoing* ring carries the
//! messages that this end sends, and the *incoming* ring carries the messages that it receives.

mod lane;
mod memory;
mod message;
#[cfg(any(kani, test))]
mod proofs;
mod receiver;
mod segments;
mod send_queue;
mod sender;
mod wake;
mod word;

pub(super) use self::{
    lane::RingLane,
    message::{RingMessage, RingSendError},
    receiver::{NotReleased, NotTaken, RingReceiver},
    segments::RingSegments,
    send_queue::SendQueue,
    sender::RingSender,
    wake::wake_parked,
};
pub use self::{
    memory::RingMemory,
    wake::{Wake, doorbell},
    word::{At, EMPTY, NotAWord, RingLayout, SlotHead, Word},
};
