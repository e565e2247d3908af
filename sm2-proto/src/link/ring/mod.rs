//! The ring lane of a link: SPEC section 8.5.
//!
//! A ring is a file of words that both ends map for writing. This module decides which word is
//! written, and where, and checks every word that is read. It accesses the words through
//! [`RingMemory`], which the driver lends for one call. Every word that the other end can write
//! leads to a message, to no message, or to a violation.
//!
//! A link of a topic has one ring. A link of a service has two: the *outgoing* ring carries the
//! messages that this end sends, and the *incoming* ring carries the messages that it receives.
//!
//! # Words, but no indexes
//!
//! Each side keeps its own count, and accesses the word that this count selects, so there is no shared head or tail to
//! forge. The sender swaps; the receiver compares and exchanges. A displaced word returns to the sender by the same
//! swap that displaces it, so keep-last is exact and the slot is free at once. Released messages return through words
//! of their own, one for each message that may be unreleased. A short message in the *cell* of its word is not given
//! back: it is settled when the receiver has taken the word.
//!
//! # Few cache lines travel between cores
//!
//! The cost of a short message between two cores is the number of cache lines that both of them touch, and that one
//! of them waits for. These measures reduce it:
//!
//! - A short message is in the two lines of its cell, and up to 40 bytes are in the line of its word (SM2-RNG-013). It
//!   touches no slot and no back word. The sender empties a cell that was not taken before it writes the cell, so a
//!   receiver's copy is whole if its compare-and-exchange succeeds.
//! - Slots are as short as their messages, with payload and head side by side. Slots of a page each would compete for
//!   one set of the first-level cache, and for one entry each of the translation cache.
//! - A publisher reads released words when it needs a slot, not with each message. While few messages are unreleased,
//!   it does not read the next word either: the receiver has emptied it, and watches the line.
//! - A publisher that waits for room checks rarely, for 20 µs, before it sleeps. Each check takes the cache line away
//!   from the receiver that is about to write it.
//! - Each side fetches a line before it waits for it: the publisher the slot that the next message takes; a receiver
//!   that spins the word that it found, then head and payload, while it reads the clock; and each receiver the slot of
//!   the message after the one that it takes. No read overtakes the atomic operation on a word.
//! - Messages that a program gives back together are one batch: their words are put, then one fence follows
//!   (SM2-RNG-012).

mod cell;
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

pub use self::{
    cell::{CELL_WORDS, CellBytes, CellMessage, CellView, CellWord},
    memory::RingMemory,
    message::RingMessage,
    wake::{Wake, doorbell},
    word::{At, EMPTY, NotAWord, RingLayout, SlotHead, Word},
};
pub(super) use self::{
    lane::RingLane,
    message::RingSendError,
    receiver::{NotReleased, NotTaken, RingReceiver, TakenMessage},
    segments::RingSegments,
    send_queue::SendQueue,
    sender::RingSender,
    wake::wake_parked,
};
