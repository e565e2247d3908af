//! One end of a link (SPEC sections 6 to 9), for all four roles.
//!
//! | to do | call |
//! | --- | --- |
//! | feed | [`handle`](crate::Machine::handle) with each datagram, command of the application, change of the socket |
//! | drain | [`poll`](crate::Machine::poll) until it returns `None`, after every feed |
//! | messages | [`Link::send`], [`Link::take`], [`Link::release`], [`Link::has_room`], the same on both lanes |
//! | deadline | [`deadline`](crate::Machine::deadline): the next [`Input::Tick`] of a link with a deadline or a lease |
//! | inspect | [`Link::is_open`], [`Link::end`], [`Link::counters`], [`Link::placement`], … |
//!
//! The machine does no I/O, reads no clock and sees no descriptor. Its driver owns the socket, the
//! mappings and the payloads. One place in the driver matches [`Output`].
//!
//! * The driver drains all outputs before it feeds a datagram, since [`Output::Attach`],
//!   [`Output::Ring`] and [`Output::Keep`] refer to the descriptor of *the datagram just handled*. A
//!   debug assertion checks this. All other inputs are legal while outputs wait. The driver closes a
//!   descriptor that no output asks for.
//! * If the socket does not accept a packet, the driver keeps that packet and feeds
//!   [`Input::Blocked`]. Until [`Input::Writable`], all other messages stay in the machine, where
//!   keep-last can still displace them.
//! * The machine settles each message exactly once after [`Link::send`] has accepted it. Until the
//!   message is settled, the driver must not change its payload.
//! * The first reason to end stays: every later input returns [`Error::Ended`] with that reason.
//!   Before [`Output::Ended`], all messages are settled, and a CLOSE is transmitted if one is due
//!   and the socket is not blocked. After the end, the application can still take the messages that
//!   were ready; on the ring lane not after a violation (SM2-RNG-010). It still has to release a
//!   taken message to stay within `max_borrowed`. On the socket lane no RELEASE is sent for it; on
//!   the ring lane its word is still put, as the sender may not know of the end.
//! * A sender must not write again to slots whose messages were settled as [`Fate::Closed`]
//!   (SM2-OPN-010).
//!
//! # Messages
//!
//! Both lanes have the same methods. The ring lane needs memory that both ends map: the driver
//! lends this memory for one call as a [`LinkMemory`]. A link of the socket lane does not touch the
//! memory, so its driver can pass [`NoMemory`].
//!
//! | a sender's driver | calls |
//! | --- | --- |
//! | before it writes a message | [`Link::placement`]: where the payload has to be |
//! | before it waits, or may choose | [`Link::has_room`] |
//! | before it writes a message | [`Link::peer_max_len`]: for a longer one, [`Input::Drop`] |
//! | for each message | [`Link::send`]; if that returns [`Misuse::NotAttached`], [`Input::Attach`], and once more |
//! | for a short message, instead | [`Link::takes_cells`]: if so, [`Link::send_in_cell`] |
//! | to learn what came back | [`Link::harvest`] |
//! | before it sleeps until there is room | [`Link::park`], and looks again |
//!
//! | a receiver's driver | calls |
//! | --- | --- |
//! | for the next message | [`Link::take`], then [`Link::made_room`] (once for several) |
//! | for each message that it took | [`Link::is_expired`]: if so, [`Link::expire`], and the next one |
//! | when the application gives one back | [`Link::release`], or [`Link::release_all`]; not for [`Payload::Cell`] |
//! | before it sleeps | [`Link::park`], and looks again |
//!
//! The driver of a caller or server uses both tables, with one difference: on an open link,
//! [`Link::send`] queues a message that has no room yet, and attaches segments by itself.
//! It never returns [`Misuse::NoRoom`] or [`Misuse::NotAttached`]; the limit of calls bounds the
//! queue. The driver drains after `send` and after each other change. While [`Link::is_due`] returns
//! `true`, the driver calls [`Link::harvest`], which sends queued messages, and drains again.
//!
//! When a call returns [`Wake::Needed`], the driver sends [`doorbell`] over the socket.
//!
//! # What changes the machine beside `handle`
//!
//! These methods alone, because they use the memory that both ends map, which an input cannot carry, and because a
//! message of a ring is too short for a queue of outputs:
//!
//! | method | change |
//! | --- | --- |
//! | [`Link::send`], [`Link::send_in_slot`], [`Link::send_in_cell`] | a message is sent or queued |
//! | [`Link::harvest`], [`Link::settle_returned`] | messages that came back are settled; `harvest` sends queued ones |
//! | [`Link::take`], [`Link::take_with`] | the application has the next message |
//! | [`Link::release`], [`Link::release_all`], [`Link::expire`] | messages are given back |
//! | [`Link::watch_mut`] | what the watch has counted was reported to the program |
//!
//! Each of them may end the link, and may leave outputs, so the driver drains afterwards while [`Link::has_output`]
//! returns `true`.
//!
//! A program that embeds this crate without `sm2-node` needs only this module and [`wire`]. The
//! machine in [`node`](crate::node) decides which links exist.
//!
//! # Window and release are one mechanism
//!
//! In OPEN, the receiving side states how many unreleased messages it accepts (`depth + max_borrowed`), and a sender
//! never has more in flight. A receiver's memory is therefore bounded by its own request, and the queue of a socket
//! never overflows in the middle of a message. One RELEASE returns the slot of a pool, gives credit, and reports the
//! fate of the message. A message in a cell of a ring is released when it is taken. Each message has exactly one fate,
//! so the messages that were offered are at every moment those that were delivered, dropped for one of the reasons, or
//! in flight.

mod absence;
mod attachments;
mod calls;
mod config;
mod debt;
mod fate;
mod frame_kind;
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) mod fuzz;
mod inbound;
mod inspect;
mod lane;
mod machine;
mod max_len;
mod memory;
mod messages;
mod outbound;
mod packet;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod publications;
mod qos;
mod receive;
mod ring;
mod role;
mod segments;
mod socket_lane;
mod status;
mod types;
pub mod wire;

pub use self::{
    absence::{Absences, Account, Missed, Record},
    config::Config,
    fate::{Counters, Fate},
    frame_kind::{Carrier, FrameKind},
    lane::LaneKind,
    machine::Link,
    max_len::MaxLen,
    memory::{LentRing, LinkMemory, NoMemory, NoRing},
    packet::{Attachment, Head, Packet},
    publications::Publications,
    ring::{
        At, CELL_WORDS, CellBytes, CellMessage, CellView, CellWord, EMPTY, NotAWord, RingLayout,
        RingMemory, RingMessage, SlotHead, Wake, Word, doorbell,
    },
    role::Role,
    segments::{SegmentInfo, SlotRange},
    status::Status,
    types::{
        Body, Delivery, End, Error, Input, Misuse, NoDelivery, OutboundMessage, Output, Payload,
        Placement, TooManyBorrowed,
    },
};
