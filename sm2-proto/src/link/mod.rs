//! One end of a link: SPEC sections 6 to 9, for all four roles.
//!
//! | to do | call |
//! | --- | --- |
//! | feed | [`Link::handle`] with each datagram, each command of the application, each change of the socket |
//! | drain | [`Link::poll`] until it returns `None`, after every feed |
//! | messages | [`Link::send`], [`Link::take`], [`Link::release`], [`Link::has_room`], the same on both lanes |
//! | deadline | [`Link::deadline`]: a link has no timer in version 1 |
//! | inspect | [`Link::is_open`], [`Link::end`], [`Link::counters`], [`Link::placement`], … |
//!
//! The machine does no I/O, reads no clock and sees no descriptor. Its driver owns the socket, the
//! mappings and the payloads; one place in the driver matches [`Output`].
//!
//! * A datagram is handled and then drained before the next one: [`Output::Attach`],
//!   [`Output::Ring`] and [`Output::Keep`] speak of the descriptor of *the datagram just handled*. The
//!   driver closes a descriptor that no output asks for. A debug assertion checks the order.
//! * The driver keeps a packet that the socket does not take, and feeds [`Input::Blocked`]. All other
//!   messages stay here, where keep-last can still displace them, until [`Input::Writable`].
//! * Each message that [`Link::send`] took comes back once as settled. Until then the driver leaves
//!   the payload alone.
//! * The first reason to end is the last: every later input is answered with [`Error::Ended`] and that
//!   reason. Before [`Output::Ended`], all messages are settled, and a CLOSE goes out if one is due and
//!   the socket is not blocked. Messages that were ready can still be taken, and a taken one still has
//!   to be released before another can be taken in its stead; nothing of it is sent.
//!   A sender must not write again to slots that were settled as [`Fate::Closed`] (SM2-OPN-008).
//!
//! # Messages
//!
//! Both lanes have the same methods. The ring lane needs memory that both ends map: a driver lends it
//! for one call as a [`LinkMemory`]. A link of the socket lane does not touch that memory, and
//! [`NoMemory`] stands for none.
//!
//! | a sender's driver | calls |
//! | --- | --- |
//! | before it writes a message | [`Link::placement`]: where the payload has to be |
//! | before it waits, or may choose | [`Link::has_room`] |
//! | for each message | [`Link::send`]; if that returns [`Misuse::NotAttached`], [`Input::Attach`], and once more |
//! | to learn what came back | [`Link::harvest`] |
//! | before it sleeps until there is room | [`Link::park`], and looks again |
//!
//! | a receiver's driver | calls |
//! | --- | --- |
//! | for the next message | [`Link::take`], then [`Link::made_room`]; [`Link::peek`] says what to prefetch |
//! | when the application gives one back | [`Link::release`] |
//! | before it sleeps | [`Link::park`], and looks again |
//!
//! A caller's or server's driver does both, except that [`Link::send`] takes every message and
//! attaches segments by itself. After it and after each other change the driver drains, and as long as
//! [`Link::is_due`] returns `true` it calls [`Link::harvest`], which sends messages that wait, and
//! drains again.
//!
//! Where a call returns [`Wake::Needed`], the driver sends [`doorbell`] by the socket.
//!
//! A program that embeds this without `sm2-node` finds all that it needs here and in [`wire`]; the
//! machine in [`node`](crate::node) decides which links there are.

mod attachments;
mod calls;
mod config;
mod frame_kind;
#[cfg(any(test, feature = "fuzzing"))]
pub(crate) mod fuzz;
mod inbound;
mod inspect;
mod lane;
mod machine;
mod memory;
mod messages;
mod outbound;
mod packet;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod receive;
mod ring;
mod role;
mod segments;
mod socket_lane;
mod status;
mod types;
pub mod wire;

pub use self::{
    config::Config,
    frame_kind::{Carrier, FrameKind},
    lane::LaneKind,
    machine::Link,
    memory::{Lent, LinkMemory, NoMemory, NoRing},
    packet::{Attachment, Head, Packet},
    ring::{At, EMPTY, NotAWord, RingLayout, RingMemory, SlotHead, Wake, Word, doorbell},
    role::Role,
    segments::SegmentInfo,
    status::Status,
    types::{
        Body, Counters, Delivery, End, Error, Fate, Input, Misuse, NoDelivery, OutboundMessage,
        Output, Payload, Placement, TooManyBorrowed,
    },
};
