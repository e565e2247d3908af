//! Decoding and encoding of link frames: the layouts of SPEC section 7.
//!
//! [`Frame::decode`] makes every check that needs neither the link's state nor its history, in the
//! order of SPEC section 10: kind, fixed length, reserved bytes, values out of their range, number
//! of descriptors. SPEC checks lengths that depend on the content only after the link's state, so
//! [`Frame::check_length`] is a separate step. A frame that passed both steps encodes to the bytes
//! that it was decoded from.

mod layout;

use alloc::vec::Vec;

use self::layout::Layout;
pub use super::frame_kind::Carrier;
use super::{FrameKind, Head, Publications, SegmentInfo, Status};
use crate::{Code, Datagram, Instant, LinkId, Violation, limits::MESSAGE_HEAD};

const OPEN: usize = 48;
const ATTACH: usize = 24;
const DETACH: usize = 8;
const RELEASE: usize = 8;
const CANCEL: usize = 16;
const CLOSE: usize = 8;
const RING: usize = 16;
const DOORBELL: usize = 8;
const DETACHED: usize = 8;
const ALIVE: usize = 16;

/// One link frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Frame<'a> {
    /// OPEN.
    Open(Open),
    /// ATTACH.
    Attach(SegmentInfo),
    /// DETACH.
    Detach {
        /// The segment's number.
        segment: u32,
    },
    /// DATA, REQUEST or REPLY.
    Message(MessageFrame<'a>),
    /// RELEASE.
    Release {
        /// How the messages were given back.
        given: Given,
        /// How many sequence numbers follow.
        count: u16,
        /// The bytes of the sequence numbers; [`Frame::sequences`] reads them.
        rest: &'a [u8],
    },
    /// CANCEL.
    Cancel {
        /// The id of the request.
        call: u64,
    },
    /// CLOSE.
    Close(Code),
    /// RING.
    Ring {
        /// How many forward words there are.
        depth: u16,
        /// How many back words there are.
        window: u32,
    },
    /// DOORBELL.
    Doorbell,
    /// DETACHED.
    Detached {
        /// The segment's number.
        segment: u32,
    },
    /// ALIVE.
    Alive {
        /// The time when the publisher's program asserted its liveliness.
        time: Instant,
    },
}

/// The fields of OPEN, not checked against the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Open {
    /// The number of the sender's role.
    pub role: u8,
    /// The link's version.
    pub version: u16,
    /// How many unreleased messages the sender accepts.
    pub window: u32,
    /// The link's id.
    pub link: LinkId,
    /// The lanes that the sender offers.
    pub lanes: u32,
    /// The maximum length of a message that the sender accepts, in units of 1,024 bytes.
    pub max_len: u32,
    /// The publications of the sender.
    pub publications: Publications,
}

/// Bit 0 of `lanes`: the socket lane.
pub const LANE_SOCKET: u32 = 1;
/// Bit 1 of `lanes`: the ring lane.
pub const LANE_RING: u32 = 2;

/// The fields of DATA, REQUEST and REPLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MessageFrame<'a> {
    /// DATA, REQUEST or REPLY.
    pub carrier: Carrier,
    /// Where the payload is.
    pub form: Form,
    /// The outcome of the call; [`Status::Ok`] in DATA and REQUEST.
    pub status: Status,
    /// The sequence number of the message in its direction.
    pub sequence: u64,
    /// The number of the publication or of the call.
    pub id: u64,
    /// The time of publication, or the deadline of the request.
    pub time: Instant,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// The bytes after the header: the payload if the form is inline, otherwise none.
    pub rest: &'a [u8],
}

/// Where the payload of a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Form {
    /// In the datagram, after the header.
    Inline,
    /// In a slot of an attached segment.
    Pooled {
        /// The segment's number.
        segment: u32,
        /// The slot, from 0.
        slot: u32,
    },
    /// In the file whose descriptor is sent with the datagram.
    Sealed,
}

/// How RELEASE gives its messages back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Given {
    /// The application took them.
    Consumed = 0,
    /// They were displaced before the application took them.
    Discarded = 1,
    /// They were older than their lifespan when the application would have taken them.
    Expired = 2,
}

impl<'a> Frame<'a> {
    /// Decodes a datagram, except for lengths that depend on the content.
    //= SM2-WIR-001
    pub fn decode(datagram: &Datagram<'a>) -> Result<Self, Violation> {
        datagram.check()?;
        let bytes = datagram.bytes;
        let number = bytes
            .first()
            .ok_or(violation!(UnknownFrame, "SM2-WIR-001"))?;
        let frame =
            match FrameKind::from_number(*number).ok_or(violation!(UnknownFrame, "SM2-WIR-001"))? {
                FrameKind::Open => Self::open(Layout::exactly(bytes)?)?,
                FrameKind::Attach => Self::attach(Layout::exactly(bytes)?)?,
                FrameKind::Detach => Self::detach(Layout::exactly(bytes)?)?,
                FrameKind::Data => Self::message(Carrier::Data, bytes)?,
                FrameKind::Request => Self::message(Carrier::Request, bytes)?,
                FrameKind::Reply => Self::message(Carrier::Reply, bytes)?,
                FrameKind::Release => Self::release(bytes)?,
                FrameKind::Cancel => Self::cancel(Layout::exactly(bytes)?)?,
                FrameKind::Close => Self::close(Layout::exactly(bytes)?)?,
                FrameKind::Ring => Self::ring(Layout::exactly(bytes)?)?,
                FrameKind::Doorbell => Self::doorbell(Layout::exactly(bytes)?)?,
                FrameKind::Detached => Self::detached(Layout::exactly(bytes)?)?,
                FrameKind::Alive => Self::alive(Layout::exactly(bytes)?)?,
            };
        //= SM2-TRN-010
        datagram.check_fds(frame.fds())?;
        Ok(frame)
    }

    fn open(layout: Layout<OPEN>) -> Result<Self, Violation> {
        Ok(Self::Open(Open {
            role: layout.u8::<1>(),
            version: layout.u16::<2>(),
            window: layout.u32::<4>(),
            link: LinkId {
                epoch: layout.u64::<8>(),
                serial: layout.u64::<16>(),
            },
            lanes: layout.u32::<24>(),
            max_len: layout.u32::<28>(),
            publications: Publications {
                publisher: layout.u64::<32>(),
                published: layout.u64::<40>(),
            },
        }))
    }

    fn attach(layout: Layout<ATTACH>) -> Result<Self, Violation> {
        layout.check_zero::<1, 3>()?;
        layout.check_zero::<20, 4>()?;
        Ok(Self::Attach(SegmentInfo {
            id: layout.u32::<4>(),
            stride: layout.u64::<8>(),
            slots: layout.u32::<16>(),
        }))
    }

    fn detach(layout: Layout<DETACH>) -> Result<Self, Violation> {
        layout.check_zero::<1, 3>()?;
        Ok(Self::Detach {
            segment: layout.u32::<4>(),
        })
    }

    fn message(carrier: Carrier, bytes: &'a [u8]) -> Result<Self, Violation> {
        let (layout, rest) = Layout::<MESSAGE_HEAD>::split(bytes)?;
        let form = layout.u8::<1>();
        if carrier != Carrier::Reply {
            layout.check_zero::<2, 2>()?;
        }
        if form != Form::POOLED {
            layout.check_zero::<4, 8>()?;
        }
        layout.check_zero::<12, 4>()?;
        let form = match form {
            Form::INLINE => Form::Inline,
            Form::POOLED => Form::Pooled {
                segment: layout.u32::<4>(),
                slot: layout.u32::<8>(),
            },
            Form::SEALED => Form::Sealed,
            //= SM2-PAY-001
            _ => return Err(violation!(Malformed, "SM2-PAY-001")),
        };
        Ok(Self::Message(MessageFrame {
            carrier,
            form,
            status: Status::from_number(layout.u16::<2>())
                .ok_or(violation!(Malformed, "SM2-SRV-002"))?,
            sequence: layout.u64::<16>(),
            id: layout.u64::<24>(),
            time: Instant(layout.u64::<32>()),
            len: layout.u64::<40>(),
            rest,
        }))
    }

    fn release(bytes: &'a [u8]) -> Result<Self, Violation> {
        let (layout, rest) = Layout::<RELEASE>::split(bytes)?;
        layout.check_zero::<4, 4>()?;
        let given =
            Given::from_number(layout.u8::<1>()).ok_or(violation!(Malformed, "SM2-MSG-004"))?;
        Ok(Self::Release {
            given,
            count: layout.u16::<2>(),
            rest,
        })
    }

    fn cancel(layout: Layout<CANCEL>) -> Result<Self, Violation> {
        layout.check_zero::<1, 7>()?;
        Ok(Self::Cancel {
            call: layout.u64::<8>(),
        })
    }

    fn close(layout: Layout<CLOSE>) -> Result<Self, Violation> {
        layout.check_zero::<1, 1>()?;
        layout.check_zero::<4, 4>()?;
        Ok(Self::Close(Code(layout.u16::<2>())))
    }

    fn ring(layout: Layout<RING>) -> Result<Self, Violation> {
        layout.check_zero::<1, 1>()?;
        layout.check_zero::<8, 8>()?;
        Ok(Self::Ring {
            depth: layout.u16::<2>(),
            window: layout.u32::<4>(),
        })
    }

    fn doorbell(layout: Layout<DOORBELL>) -> Result<Self, Violation> {
        layout.check_zero::<1, 7>()?;
        Ok(Self::Doorbell)
    }

    fn detached(layout: Layout<DETACHED>) -> Result<Self, Violation> {
        layout.check_zero::<1, 3>()?;
        Ok(Self::Detached {
            segment: layout.u32::<4>(),
        })
    }

    fn alive(layout: Layout<ALIVE>) -> Result<Self, Violation> {
        layout.check_zero::<1, 7>()?;
        Ok(Self::Alive {
            time: Instant(layout.u64::<8>()),
        })
    }

    /// Checks that the bytes after the header have the length that the header states.
    //= SM2-WIR-001, SM2-PAY-002
    pub fn check_length(&self) -> Result<(), Violation> {
        let (expected, rest) = match self {
            Self::Message(MessageFrame {
                form: Form::Inline,
                len,
                rest,
                ..
            }) => (*len, *rest),
            Self::Message(MessageFrame { rest, .. }) => (0, *rest),
            Self::Release { count, rest, .. } => (8 * u64::from(*count), *rest),
            _ => return Ok(()),
        };
        if rest.len() as u64 == expected {
            Ok(())
        } else {
            Err(violation!(BadLength, "SM2-WIR-001"))
        }
    }

    /// The kind of the frame.
    #[must_use]
    pub const fn kind(&self) -> FrameKind {
        match self {
            Self::Open(_) => FrameKind::Open,
            Self::Attach(_) => FrameKind::Attach,
            Self::Detach { .. } => FrameKind::Detach,
            Self::Message(message) => message.carrier.kind(),
            Self::Release { .. } => FrameKind::Release,
            Self::Cancel { .. } => FrameKind::Cancel,
            Self::Close(_) => FrameKind::Close,
            Self::Ring { .. } => FrameKind::Ring,
            Self::Doorbell => FrameKind::Doorbell,
            Self::Detached { .. } => FrameKind::Detached,
            Self::Alive { .. } => FrameKind::Alive,
        }
    }

    /// The number of descriptors that are sent with the frame.
    #[must_use]
    pub const fn fds(&self) -> usize {
        match self {
            Self::Attach(_)
            | Self::Ring { .. }
            | Self::Message(MessageFrame {
                form: Form::Sealed, ..
            }) => 1,
            _ => 0,
        }
    }

    /// The sequence numbers in RELEASE; none for any other frame.
    pub fn sequences(&self) -> impl Iterator<Item = u64> + use<'a> {
        let rest: &'a [u8] = match self {
            Self::Release { rest, .. } => rest,
            _ => &[],
        };
        rest.as_chunks()
            .0
            .iter()
            .map(|number| u64::from_le_bytes(*number))
    }

    /// Encodes the header: the frame without the `rest` of a message or RELEASE.
    #[must_use]
    pub fn head(&self) -> Head {
        match self {
            Self::Open(open) => Layout::<OPEN>::of(self.kind())
                .with::<1, 1>([open.role])
                .with::<2, 2>(open.version.to_le_bytes())
                .with::<4, 4>(open.window.to_le_bytes())
                .with::<8, 8>(open.link.epoch.to_le_bytes())
                .with::<16, 8>(open.link.serial.to_le_bytes())
                .with::<24, 4>(open.lanes.to_le_bytes())
                .with::<28, 4>(open.max_len.to_le_bytes())
                .with::<32, 8>(open.publications.publisher.to_le_bytes())
                .with::<40, 8>(open.publications.published.to_le_bytes())
                .head(),
            Self::Attach(segment) => Layout::<ATTACH>::of(self.kind())
                .with::<4, 4>(segment.id.to_le_bytes())
                .with::<8, 8>(segment.stride.to_le_bytes())
                .with::<16, 4>(segment.slots.to_le_bytes())
                .head(),
            Self::Detach { segment } => Layout::<DETACH>::of(self.kind())
                .with::<4, 4>(segment.to_le_bytes())
                .head(),
            Self::Message(message) => message.head(),
            Self::Release { given, count, .. } => Layout::<RELEASE>::of(self.kind())
                .with::<1, 1>([*given as u8])
                .with::<2, 2>(count.to_le_bytes())
                .head(),
            Self::Cancel { call } => Layout::<CANCEL>::of(self.kind())
                .with::<8, 8>(call.to_le_bytes())
                .head(),
            Self::Close(code) => Layout::<CLOSE>::of(self.kind())
                .with::<2, 2>(code.0.to_le_bytes())
                .head(),
            Self::Ring { depth, window } => Layout::<RING>::of(self.kind())
                .with::<2, 2>(depth.to_le_bytes())
                .with::<4, 4>(window.to_le_bytes())
                .head(),
            Self::Doorbell => Layout::<DOORBELL>::of(self.kind()).head(),
            Self::Detached { segment } => Layout::<DETACHED>::of(self.kind())
                .with::<4, 4>(segment.to_le_bytes())
                .head(),
            Self::Alive { time } => Layout::<ALIVE>::of(self.kind())
                .with::<8, 8>(time.0.to_le_bytes())
                .head(),
        }
    }

    /// Encodes the whole frame.
    #[must_use]
    pub fn to_vec(&self) -> Vec<u8> {
        let rest = match self {
            Self::Message(MessageFrame { rest, .. }) | Self::Release { rest, .. } => rest,
            _ => &[][..],
        };
        [&self.head()[..], rest].concat()
    }
}

impl MessageFrame<'_> {
    fn head(&self) -> Head {
        let (form, segment, slot) = match self.form {
            Form::Inline => (Form::INLINE, 0, 0),
            Form::Pooled { segment, slot } => (Form::POOLED, segment, slot),
            Form::Sealed => (Form::SEALED, 0, 0),
        };
        Layout::<MESSAGE_HEAD>::of(self.carrier.kind())
            .with::<1, 1>([form])
            .with::<2, 2>((self.status as u16).to_le_bytes())
            .with::<4, 4>(segment.to_le_bytes())
            .with::<8, 4>(slot.to_le_bytes())
            .with::<16, 8>(self.sequence.to_le_bytes())
            .with::<24, 8>(self.id.to_le_bytes())
            .with::<32, 8>(self.time.0.to_le_bytes())
            .with::<40, 8>(self.len.to_le_bytes())
            .head()
    }
}

impl Form {
    const INLINE: u8 = 0;
    const POOLED: u8 = 1;
    const SEALED: u8 = 2;
}

impl Given {
    const fn from_number(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Consumed),
            1 => Some(Self::Discarded),
            2 => Some(Self::Expired),
            //= SM2-MSG-004
            _ => None,
        }
    }
}
