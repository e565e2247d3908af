//! Inputs, outputs, messages and errors of the link machine.

use bytes::Bytes;

use super::{CellBytes, Fate, Packet, RingLayout, SegmentInfo, Status};
use crate::{Code, Datagram, Instant, Newest, Violation};

/// Something that happened to a link, which the driver reports.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The other end sent a datagram. A datagram without bytes is the end of the stream.
    Datagram(Datagram<'a>),
    /// The stream ended: the other end's process is gone, or it closed the socket.
    Eof,
    /// The driver does not send a publication on this link alone, which counts with this fate:
    ///
    /// * [`Fate::Overwritten`]: the link has no slot or no room at this moment.
    /// * [`Fate::NoRoom`]: the deadline of the publication passed while a reliable publisher waited for room, or it
    ///   does not wait for this link. The link [owes](super::Link::owes) from then on.
    /// * [`Fate::PoolLimit`]: unsettled messages of this link take too much of the publisher's memory. The link owes
    ///   from then on.
    /// * [`Fate::TooLong`]: the publication is longer than [`Link::peer_max_len`](super::Link::peer_max_len).
    /// * [`Fate::Expired`]: the publication is older than its lifespan.
    ///
    /// All others are [`Misuse::WrongFate`].
    Drop(Fate),
    /// The publisher's program asserted its liveliness at this time. The machine sends ALIVE if the subscriber demands
    /// a lease.
    Assert(Instant),
    /// The time of [`deadline`](crate::Machine::deadline) has come, and the driver has fed all datagrams that the
    /// socket has. Its value is [`Link::newest`](super::Link::newest). A receiver counts the periods of the deadline
    /// that have passed without a message, and checks whether the publisher is alive. A sender sends ALIVE that was
    /// held back. As each input does, it drops messages that wait at this end and are older than their lifespan, so
    /// that there is room.
    Tick(Newest),
    /// Ring lane, after [`NoDelivery::UnknownSegment`](super::NoDelivery::UnknownSegment): the
    /// socket has no further datagram that could attach the segment of the message.
    SegmentMissing,
    /// The caller no longer wants the reply. CANCEL is sent once, however often this input is fed.
    /// A call that already has its reply is not affected.
    Cancel {
        /// The [`OutboundMessage::id`] of the request.
        call: u64,
    },
    /// The application will use this segment. The ring lane sends ATTACH if the segment is not
    /// attached. Once the outputs are drained, messages can use the segment, unless the driver had
    /// to feed [`Input::Blocked`]. The socket lane attaches a segment with its first message.
    Attach(SegmentInfo),
    /// The application will not use this segment again. The machine sends DETACH if the segment is
    /// attached.
    Retire {
        /// The [`SegmentInfo::id`].
        segment: u32,
    },
    /// The socket did not accept a packet, and the driver keeps that packet. The machine returns no
    /// [`Output::Transmit`] until [`Input::Writable`]. A CLOSE that was not polled yet is dropped.
    Blocked,
    /// The socket accepted the packet that the driver kept.
    Writable,
    /// Ends the link from this side.
    Close(Code),
}

/// An action that the driver has to perform. Outputs that refer to *the datagram just handled* are
/// returned before the next datagram may be fed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send this packet over the socket, or keep it and feed [`Input::Blocked`].
    Transmit(Packet),
    /// Both ends have sent OPEN, so the [lane](super::Link::lane) is known.
    Opened,
    /// Only on a sending end: map the descriptor of the datagram just handled, for reading and
    /// writing. It is a ring with this layout. Its seals and size were checked.
    Ring(RingLayout),
    /// Map the descriptor of the datagram just handled, for reading only. Its seals and size were
    /// checked.
    Attach {
        /// The number that messages use to refer to the segment.
        segment: u32,
        /// The size of a slot, in bytes.
        stride: u64,
        /// The number of slots; `stride * slots` is the size of the file.
        slots: u32,
    },
    /// Unmap this segment: no message of this link uses it any more.
    Detach {
        /// The segment's number.
        segment: u32,
    },
    /// Keep the descriptor of the datagram just handled for this sealed message. Its seals and size
    /// were checked.
    Keep {
        /// The message's sequence number.
        sequence: u64,
    },
    /// Close the descriptor that was kept for this message: the message was displaced before it was
    /// taken.
    Discard {
        /// The message's sequence number.
        sequence: u64,
    },
    /// The link no longer needs a message. This output comes exactly once for each message that
    /// [`Link::send`](super::Link::send) accepted, except for messages that a call passed to its
    /// `settled` closure.
    Settled {
        /// The [`OutboundMessage::key`].
        key: u64,
        /// How the message was settled.
        fate: Fate,
    },
    /// A server's client no longer wants this reply. The server still has to send one.
    Cancelled {
        /// The id of the request.
        call: u64,
    },
    /// A call will not get a reply, because the link ended first. On the ring lane, this output
    /// comes only when [`Link::take`](super::Link::take) has returned all replies that were in the
    /// ring. It can therefore follow [`Output::Ended`].
    CallFailed {
        /// The id of the request.
        call: u64,
    },
    /// The link is over. Only [`Output::CallFailed`] can follow.
    Ended(End),
}

/// One message to send.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct OutboundMessage {
    /// The driver's own name for the message, returned in [`Output::Settled`] and
    /// [`Attachment::Message`](super::Attachment::Message). The machine does not interpret it.
    pub key: u64,
    /// DATA: the publisher's count of its publications. REQUEST: the number of the call. Both
    /// increase strictly on a link. REPLY: the id of the request.
    pub id: u64,
    /// DATA: the time of publication. REQUEST: the deadline, or 0 for none.
    pub time: Instant,
    /// REPLY: the outcome of the call. All others: [`Status::Ok`].
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
    /// In a file of its own, which the driver stores under [`OutboundMessage::key`].
    Sealed,
}

/// One received message. `C` is the form of a message that came in a cell of a ring.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Delivery<C = CellBytes> {
    /// The message's sequence number on this link, used to release it.
    pub sequence: u64,
    /// DATA: the publisher's count of its publications. REQUEST and REPLY: the call.
    pub id: u64,
    /// DATA: the time of publication. REQUEST: the deadline, or 0 for none.
    pub time: Instant,
    /// REPLY: the outcome of the call. All others: [`Status::Ok`].
    pub status: Status,
    /// The number of publications that the application misses between the message that it took
    /// before and this one. For the first message, the count starts at the first publication that
    /// was sent on this link. Always zero on links of services.
    pub lost: u64,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// Where the payload is.
    pub payload: Payload<C>,
}

impl<C> Delivery<C> {
    /// The same message, with the form of a cell that `change` returns.
    #[inline]
    pub fn map_cell<D>(self, change: impl FnOnce(C) -> D) -> Delivery<D> {
        Delivery {
            sequence: self.sequence,
            id: self.id,
            time: self.time,
            status: self.status,
            lost: self.lost,
            len: self.len,
            payload: match self.payload {
                Payload::Inline(bytes) => Payload::Inline(bytes),
                Payload::Pooled { segment, offset } => Payload::Pooled { segment, offset },
                Payload::Cell(cell) => Payload::Cell(change(cell)),
                Payload::Sealed => Payload::Sealed,
            },
        }
    }
}

/// Where the payload of a received message is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Payload<C = CellBytes> {
    /// In this value: exactly `len` bytes.
    Inline(Bytes),
    /// In an attached segment. The range from `offset` to `offset + len` lies within the segment.
    Pooled {
        /// The segment's number.
        segment: u32,
        /// The offset of the slot in the segment, in bytes.
        offset: u64,
    },
    /// In this value, which is a copy of the message's cell in the ring. It is not released.
    Cell(C),
    /// At the start of the file that [`Output::Keep`] referred to.
    Sealed,
}

/// Why a link is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// This side closed the link with this code, by [`Input::Close`].
    #[error("this side closed the link: {0}")]
    Local(Code),
    /// The other end sent CLOSE with this code.
    #[error("the other side closed the link: {0}")]
    Peer(Code),
    /// The stream ended without CLOSE.
    #[error("the other side is gone")]
    Eof,
    /// The other end violated SPEC.
    #[error("the other side broke the protocol: {0}")]
    Violation(Violation),
}

/// The reason why [`Machine::handle`](crate::Machine::handle) did not do what its input asked for.
pub type Error = crate::Error<End, Misuse>;

/// How the code that uses the machine can break its contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Misuse {
    /// This role, or this kind of link, does not support the call or input.
    #[error("the role or QoS of this end does not allow that")]
    WrongRole,
    /// `len` is not the length of the inline payload.
    #[error("len differs from the length of the inline payload")]
    Length,
    /// The payload is longer than its form allows.
    #[error(
        "the payload is longer than its form allows: inline 61,440 bytes, pooled one slot, all 2^40"
    )]
    TooLong,
    /// The message is longer than the other end accepts.
    #[error("the message is longer than the other end accepts: see peer_max_len")]
    NotAccepted,
    /// A pooled message on a sealed link.
    #[error("pooled messages are illegal on a sealed link: send it sealed or inline")]
    NotSealed,
    /// The segment's stride or slots are out of range.
    #[error(
        "a segment's stride is a multiple of 64, its slots are 1 to 65,536, its size is at most 2^41 bytes"
    )]
    BadSegment,
    /// A segment with this number is in use with another stride or another number of slots.
    #[error("the segment of that number has another stride or other slots: retire it first")]
    SegmentChanged,
    /// The slot's number is not below the segment's number of slots.
    #[error("the segment has no such slot")]
    SlotOutside,
    /// The slot holds a message of this link that is not settled.
    #[error("the slot holds a message of this link that is not settled")]
    SlotBusy,
    /// Unsettled messages of this link already use 256 other segments.
    #[error("unsettled messages of this link use 256 other segments: wait until some are settled")]
    SegmentLimit,
    /// The segment holds messages of this link that are not settled, or its DETACHED has not come.
    #[error(
        "the segment holds unsettled messages of this link, or is being detached: try again later"
    )]
    SegmentBusy,
    /// The id is 0, or not greater than the previous id.
    #[error("ids begin at 1 and grow with every message of a link")]
    IdNotGrowing,
    /// DATA or REQUEST has a status other than ok, or a message with a payload has a status that
    /// allows none.
    #[error("only replies have a status, and only ok and failed ones a payload")]
    Status,
    /// The window and the queue are full, and the link is reliable.
    #[error("there is no room: wait until has_room, or skip the message")]
    NoRoom,
    /// [`Input::Drop`] with [`Fate::NoRoom`] was fed while the link had room.
    #[error("there is room: send the message")]
    RoomLeft,
    /// [`Input::Drop`] was fed with a fate that only the machine finds.
    #[error("only the machine finds that fate: drop a publication by another one")]
    WrongFate,
    /// 1,024 calls of this link have no reply yet.
    #[error("1,024 calls of this link have no reply yet: wait for some")]
    CallLimit,
    /// Server: the call is not open, or already has its reply. Caller: the call was never made.
    #[error("no such call is open")]
    UnknownCall,
    /// The other end's OPEN has not come, or the RING of the ring that this end sends through has
    /// not come.
    #[error("the link is not open yet: wait until is_open")]
    NotOpen,
    /// The driver did not lend the ring that this call needs.
    #[error("the ring of this link was not lent: map it, and lend it with each call")]
    NotLent,
    /// The payload is not where [`Link::placement`](super::Link::placement) says.
    #[error("the payload has to be in a slot: see placement")]
    NotPooled,
    /// The segment is not attached: it was never attached, or it was detached.
    #[error("the segment is not attached: feed attach, drain the outputs, and try again")]
    NotAttached,
    /// The application does not hold the message.
    #[error("no such message is taken and unreleased")]
    NotBorrowed,
}

/// Where the payload of a message has to be so that a link can send it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Placement {
    /// In a slot, with its [head](super::SlotHead) at the slot's end: [`Body::Pooled`].
    Slot,
    /// A short payload in the datagram, a longer one in a slot: any [`Body`].
    InlineOrSlot,
    /// A short payload in the datagram, a longer one in a file of its own: [`Body::Inline`] or
    /// [`Body::Sealed`].
    InlineOrSealed,
}

/// The reason why [`Link::take`](super::Link::take) returns no message, although one may be ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoDelivery {
    /// The application already holds `max_borrowed` messages.
    #[error(transparent)]
    TooManyBorrowed(TooManyBorrowed),
    /// Ring lane: the message is in a segment that is not attached. Feed all datagrams that the
    /// socket has, and try again. If the socket has none, feed [`Input::SegmentMissing`].
    #[error("the message is in a segment that is not attached yet")]
    UnknownSegment,
    /// Ring lane: the link is over, perhaps by a violation that this call found.
    #[error(transparent)]
    Ended(End),
    /// This end does not receive, or its ring was not lent.
    #[error(transparent)]
    Misuse(Misuse),
}

/// The application already holds `max_borrowed` messages of this link (SM2-MSG-005).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error("{max_borrowed} messages of this link are taken and unreleased: release one first")]
pub struct TooManyBorrowed {
    /// How many messages it may hold.
    pub max_borrowed: u16,
}
