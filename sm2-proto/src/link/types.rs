//! What goes into the machine and what comes out of it.

use bytes::Bytes;

use super::{Packet, RingLayout, SegmentInfo, Status};
use crate::{Code, Datagram, Instant, Violation};

/// What happens to a link.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The other end sent a datagram. One without bytes is the end of the stream.
    Datagram(Datagram<'a>),
    /// The stream ended: the other end's process is gone, or it closed the socket.
    Eof,
    /// A reliable publisher's deadline passed while it waited for room: one
    /// message is dropped for this link alone.
    Skip,
    /// A publication is not sent on this link, which has no room for it at this moment. It counts as
    /// [`Fate::Overwritten`].
    PassOver,
    /// Ring lane, after [`NoDelivery::UnknownSegment`](super::NoDelivery::UnknownSegment): no
    /// datagram is there that could attach the segment of the message.
    SegmentMissing,
    /// The caller no longer wants the reply. Sent once, however often it is
    /// asked for; a call that has its reply is left alone.
    Cancel {
        /// The [`OutboundMessage::id`] of the request.
        call: u64,
    },
    /// The application will use this segment. The ring lane sends ATTACH if the segment is not
    /// attached, and messages can name the segment once the outputs are drained, unless
    /// [`Input::Blocked`] came of them. The socket lane attaches a segment with its first message.
    Attach(SegmentInfo),
    /// The application will not use this segment again: DETACH, if it is attached.
    Retire {
        /// The [`SegmentInfo::id`].
        segment: u32,
    },
    /// The socket did not take a packet, and the driver keeps it: no
    /// [`Output::Transmit`] until [`Input::Writable`]. A CLOSE not yet polled is dropped.
    Blocked,
    /// The socket took the packet that the driver kept.
    Writable,
    /// Ends the link from this side.
    Close(Code),
}

/// What a driver has to do. Outputs that speak of *the datagram just handled*
/// come before the next one may be fed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Hand this packet to the socket, or keep it and feed [`Input::Blocked`].
    Transmit(Packet),
    /// Both ends have sent OPEN.
    Opened,
    /// A receiving end, before [`Output::Opened`]: make the file of a ring with this layout, all
    /// zero, with the seals [`Seals::RING`](crate::Seals::RING), and map it for writing. RING will
    /// take it along.
    MakeRing(RingLayout),
    /// A sending end: map the descriptor of the datagram just handled, for reading and writing. It
    /// is a ring with this layout, whose seals and size are as SPEC demands.
    Ring(RingLayout),
    /// Map the descriptor of the datagram just handled, for reading only: its
    /// seals and its size are as SPEC demands.
    Attach {
        /// The number by which messages name the segment.
        segment: u32,
        /// The size of a slot, in bytes.
        stride: u64,
        /// How many slots there are; `stride * slots` is the size of the file.
        slots: u32,
    },
    /// No message of this link uses the segment any more: unmap it.
    Detach {
        /// The segment's number.
        segment: u32,
    },
    /// Keep the descriptor of the datagram just handled for this sealed message:
    /// its seals and its size are as SPEC demands.
    Keep {
        /// The message's sequence number.
        sequence: u64,
    },
    /// The message was displaced before it was taken: forget what was kept for it.
    Discard {
        /// The message's sequence number.
        sequence: u64,
    },
    /// The link is done with a message. Exactly one for each message that
    /// [`Link::send`](super::Link::send) took, except for those that it passed to its `settled`.
    Settled {
        /// The [`OutboundMessage::key`].
        key: u64,
        /// What became of the message.
        fate: Fate,
    },
    /// A server's client no longer wants this reply, but still expects one.
    Cancelled {
        /// The id of the request.
        call: u64,
    },
    /// A caller will not get the reply: the link ended before it. On the ring lane this output comes
    /// when [`Link::take`](super::Link::take) has returned the replies that had come, if need be
    /// after [`Output::Ended`].
    CallFailed {
        /// The id of the request.
        call: u64,
    },
    /// The link is over: nothing comes after this but [`Output::CallFailed`].
    Ended(End),
}

/// One message to send.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct OutboundMessage {
    /// The driver's own name for it, as it comes back in [`Output::Settled`]
    /// and [`Attachment::Message`](super::Attachment::Message). The machine only carries it.
    pub key: u64,
    /// DATA: the publisher's count of its publications. REQUEST: the number of
    /// the call. Both grow on a link. REPLY: the id of the request.
    pub id: u64,
    /// DATA: the moment of publication. REQUEST: the deadline, 0 for none.
    pub time: Instant,
    /// REPLY: how the call went. All others: [`Status::Ok`].
    pub status: Status,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// Where the payload is.
    pub body: Body,
}

/// Where the payload of a message to send is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Body {
    /// In the datagram: at most [`INLINE_MAX`](crate::limits::INLINE_MAX) bytes.
    Inline(Bytes),
    /// In a slot of a shared segment.
    Pooled {
        /// The segment. It is attached when the link first needs it.
        segment: SegmentInfo,
        /// The slot, from 0.
        slot: u32,
    },
    /// In a file of its own, which the driver keeps under [`OutboundMessage::key`].
    Sealed,
}

/// One received message.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Delivery {
    /// Its number on this link, by which it is released.
    pub sequence: u64,
    /// DATA: the publisher's count of its publications. REQUEST and REPLY: the call.
    pub id: u64,
    /// DATA: the moment of publication. REQUEST: the deadline, 0 for none.
    pub time: Instant,
    /// REPLY: how the call went. All others: [`Status::Ok`].
    pub status: Status,
    /// How many publications the application will never see that came after
    /// the one it took before this (or since the first that reached this
    /// link). Always zero on links of services.
    pub lost: u64,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// Where the payload is.
    pub payload: Payload,
}

/// Where the payload of a received message is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Payload {
    /// Here: exactly `len` bytes.
    Inline(Bytes),
    /// In an attached segment: `offset + len` is within it.
    Pooled {
        /// The segment's number.
        segment: u32,
        /// Where the slot begins, in bytes.
        offset: u64,
    },
    /// At the start of the file that [`Output::Keep`] spoke of.
    Sealed,
}

/// What became of a message that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Fate {
    /// Released as consumed: the application had it.
    Delivered,
    /// Displaced by a later one before it left this side.
    Overwritten,
    /// Displaced by a later one on the other side.
    Discarded,
    /// Never sent, because a deadline passed. Counted only: see [`Input::Skip`].
    Deadline,
    /// The link ended first.
    Closed,
}

/// What became of all messages of one link:
/// `offered = delivered + overwritten + discarded + deadline + closed + in_flight`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Counters {
    /// Every message that was sent, and every [`Input::Skip`] and [`Input::PassOver`].
    pub offered: u64,
    /// See [`Fate::Delivered`].
    pub delivered: u64,
    /// See [`Fate::Overwritten`].
    pub overwritten: u64,
    /// See [`Fate::Discarded`].
    pub discarded: u64,
    /// See [`Fate::Deadline`].
    pub deadline: u64,
    /// See [`Fate::Closed`].
    pub closed: u64,
    /// Queued on this side, or sent and not released yet.
    pub in_flight: u64,
}

/// Why a link is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// [`Input::Close`] with this code.
    #[error("this side closed the link: {0}")]
    Local(Code),
    /// The other end's CLOSE with this code.
    #[error("the other side closed the link: {0}")]
    Peer(Code),
    /// The stream ended without CLOSE.
    #[error("the other side is gone")]
    Eof,
    /// The other end broke SPEC.
    #[error("the other side broke the protocol: {0}")]
    Violation(Violation),
}

/// Why [`Link::handle`](super::Link::handle) did not do what its input asked for.
pub type Error = crate::Error<End, Misuse>;

/// How a caller of the machine can break its contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Misuse {
    /// This role, or this kind of link, has no such input.
    #[error("an end with this role does not do that")]
    WrongRole,
    /// `len` is not the length of the inline payload.
    #[error("len differs from the length of the inline payload")]
    Length,
    /// The payload is longer than its form allows.
    #[error(
        "the payload is longer than its form allows: inline 61,440 bytes, pooled one slot, all 2^40"
    )]
    TooLong,
    /// The link is sealed.
    #[error("pooled messages are illegal on a sealed link: send it sealed or inline")]
    NotSealed,
    /// The segment's stride or slots are out of range.
    #[error(
        "a segment's stride is a multiple of 4,096, its slots are 1 to 65,536, its size is at most 2^41"
    )]
    BadSegment,
    /// A segment of this number is in use with another stride or other slots.
    #[error("the segment of that number has another stride or other slots: retire it first")]
    SegmentChanged,
    /// The slot is not one of the segment's.
    #[error("the segment has no such slot")]
    SlotOutside,
    /// A message of this link that is not settled uses the slot.
    #[error("the slot holds a message of this link that is not settled")]
    SlotBusy,
    /// Messages of this link that are not settled use 256 other segments.
    #[error("unsettled messages of this link use 256 other segments: wait until some are settled")]
    SegmentLimit,
    /// Messages of this link that are not settled use the segment.
    #[error("the segment holds messages of this link that are not settled")]
    SegmentBusy,
    /// The id is 0, or not greater than the one before.
    #[error("ids begin at 1 and grow with every message of a link")]
    IdNotGrowing,
    /// DATA or REQUEST with a status, or a payload where the status allows none.
    #[error("only replies have a status, and only ok and failed ones a payload")]
    Status,
    /// Window and queue are full and the link is reliable.
    #[error("there is no room: wait until has_room, or skip the message")]
    NoRoom,
    /// [`Input::Skip`] while there is room.
    #[error("there is room: send the message")]
    RoomLeft,
    /// 1,024 calls have no reply yet.
    #[error("1,024 calls of this link have no reply yet: wait for some")]
    CallLimit,
    /// Server: the call is not open, or has its reply. Caller: it was never made.
    #[error("no such call is open")]
    UnknownCall,
    /// The other end's OPEN, or the RING that this end sends by, has not come.
    #[error("the link is not open yet: wait until is_open")]
    NotOpen,
    /// The driver did not lend the ring that this call needs.
    #[error("the ring of this link was not lent: map it, and lend it with each call")]
    NotLent,
    /// The payload is not where [`Link::placement`](super::Link::placement) says.
    #[error("the payload has to be in a slot: see placement")]
    NotPooled,
    /// The segment is not attached (any more, or yet).
    #[error("the segment is not attached: feed attach, drain the outputs, and try again")]
    NotAttached,
    /// The application does not hold the message.
    #[error("no such message is taken and unreleased")]
    NotBorrowed,
}

/// Where the payload of a message has to be, so that a link can send it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Placement {
    /// In a slot, with its [head](super::SlotHead) at the slot's end: [`Body::Pooled`].
    Slot,
    /// A short one in the datagram, others in a slot: any [`Body`].
    InlineOrSlot,
    /// A short one in the datagram, others in a file of their own: [`Body::Inline`] or
    /// [`Body::Sealed`].
    InlineOrSealed,
}

/// Why [`Link::take`](super::Link::take) returns no message, although there may be one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoDelivery {
    /// The application holds as many messages as it may.
    #[error(transparent)]
    TooManyBorrowed(TooManyBorrowed),
    /// Ring lane: the message is in a segment that is not attached. Feed all datagrams that are
    /// there, and try again. If none is there, feed [`Input::SegmentMissing`].
    #[error("the message is in a segment that is not attached yet")]
    UnknownSegment,
    /// Ring lane: the link is over, perhaps by a violation that was just found.
    #[error(transparent)]
    Ended(End),
    /// This end does not receive, or its ring was not lent.
    #[error(transparent)]
    Misuse(Misuse),
}

/// The application holds as many messages of this link as it may (SM2-MSG-005).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error("{max_borrowed} messages of this link are taken and unreleased: release one first")]
pub struct TooManyBorrowed {
    /// How many it may hold.
    pub max_borrowed: u16,
}
