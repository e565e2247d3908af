//! The layouts of SPEC section 7: bytes to [`Frame`] and back.
//!
//! [`Frame::decode`] makes every check that needs neither the link's state nor
//! its history, in the order of SPEC section 10: kind, fixed length, reserved
//! bytes, values out of their range, number of descriptors. Lengths that
//! depend on the content come after the state's violations, so they are a
//! step of their own, [`Frame::check_length`]. A frame that passed both
//! encodes to the bytes that it came from.

mod layout;

use alloc::vec::Vec;

use self::layout::Layout;
pub use super::frame_kind::Carrier;
use super::{FrameKind, Head, SegmentInfo, Status};
use crate::{Code, Datagram, Instant, LinkId, Violation, limits::MESSAGE_HEAD};

const OPEN: usize = 32;
const ATTACH: usize = 24;
const DETACH: usize = 8;
const RELEASE: usize = 8;
const CANCEL: usize = 16;
const CLOSE: usize = 8;
const RING: usize = 16;
const DOORBELL: usize = 8;
const DETACHED: usize = 8;

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
        /// What became of the messages.
        given: Given,
        /// How many sequence numbers follow.
        count: u16,
        /// What follows; [`Frame::sequences`] reads it.
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
}

/// The fields of OPEN, as they came.
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
}

/// Bit 0 of `lanes`: the socket lane.
pub const LANE_SOCKET: u32 = 1;
/// Bit 1 of `lanes`: the ring lane.
pub const LANE_RING: u32 = 2;

/// The fields of DATA, REQUEST and REPLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MessageFrame<'a> {
    /// Which of the three.
    pub carrier: Carrier,
    /// Where the payload is.
    pub form: Form,
    /// How the call went; [`Status::Ok`] in DATA and REQUEST.
    pub status: Status,
    /// The count of the messages of this direction.
    pub sequence: u64,
    /// The publication or the call.
    pub id: u64,
    /// The moment of publication, or the deadline.
    pub time: Instant,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// What follows the header: the payload if the form is inline.
    pub rest: &'a [u8],
}

/// The payload forms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Form {
    /// Behind the header.
    Inline,
    /// In a slot of an attached segment.
    Pooled {
        /// The segment's number.
        segment: u32,
        /// The slot, from 0.
        slot: u32,
    },
    /// In the file whose descriptor comes along.
    Sealed,
}

/// What RELEASE says of its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Given {
    /// The application had them.
    Consumed = 0,
    /// They were displaced before the application saw them.
    Discarded = 1,
}

impl<'a> Frame<'a> {
    /// The frame in a datagram, but for lengths that depend on its content.
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
            };
        //= SM2-TRN-005
        datagram.check_fds(frame.fds())?;
        Ok(frame)
    }

    fn open(layout: Layout<OPEN>) -> Result<Self, Violation> {
        layout.check_zero::<28, 4>()?;
        Ok(Self::Open(Open {
            role: layout.u8::<1>(),
            version: layout.u16::<2>(),
            window: layout.u32::<4>(),
            link: LinkId {
                epoch: layout.u64::<8>(),
                serial: layout.u64::<16>(),
            },
            lanes: layout.u32::<24>(),
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
            //= SM2-PAY-004
            _ => return Err(violation!(Malformed, "SM2-PAY-004")),
        };
        Ok(Self::Message(MessageFrame {
            carrier,
            form,
            status: Status::from_number(layout.u16::<2>())
                .ok_or(violation!(Malformed, "SM2-SRV-003"))?,
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

    /// Whether what follows the header is as long as the header says.
    //= SM2-WIR-001, SM2-PAY-001
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

    /// Its kind.
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
        }
    }

    /// How many descriptors it takes along.
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

    /// The sequence numbers that RELEASE names; none in any other frame.
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

    /// Its header: everything but what a message's or RELEASE's `rest` holds.
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
        }
    }

    /// The whole frame.
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
            //= SM2-MSG-004
            _ => None,
        }
    }
}
