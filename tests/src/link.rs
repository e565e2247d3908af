//! Link frames written by hand, from SPEC section 7 alone. Every field can be set to a value that
//! SPEC forbids.

use sm2_proto::LinkId;

/// The kinds of link frames.
pub mod kind {
    /// OPEN
    pub const OPEN: u8 = 1;
    /// ATTACH
    pub const ATTACH: u8 = 2;
    /// DETACH
    pub const DETACH: u8 = 3;
    /// DATA
    pub const DATA: u8 = 4;
    /// REQUEST
    pub const REQUEST: u8 = 5;
    /// REPLY
    pub const REPLY: u8 = 6;
    /// RELEASE
    pub const RELEASE: u8 = 7;
    /// CANCEL
    pub const CANCEL: u8 = 8;
    /// CLOSE
    pub const CLOSE: u8 = 9;
    /// RING
    pub const RING: u8 = 16;
    /// DOORBELL
    pub const DOORBELL: u8 = 17;
    /// DETACHED
    pub const DETACHED: u8 = 18;
    /// ALIVE
    pub const ALIVE: u8 = 19;
}

/// The roles in OPEN.
pub mod role {
    /// A publisher's end.
    pub const SENDER: u8 = 0;
    /// A subscriber's end.
    pub const RECEIVER: u8 = 1;
    /// A client's end.
    pub const CALLER: u8 = 2;
    /// A server's end.
    pub const SERVER: u8 = 3;
}

/// The payload forms.
pub mod form {
    /// In the datagram.
    pub const INLINE: u8 = 0;
    /// In a slot of a segment.
    pub const POOLED: u8 = 1;
    /// In a file of its own.
    pub const SEALED: u8 = 2;
}

/// OPEN.
#[derive(Clone, Copy, Debug)]
pub struct Open {
    /// The sender's role.
    pub role: u8,
    /// The link's version.
    pub version: u16,
    /// How many unreleased messages the sender accepts.
    pub window: u32,
    /// The link.
    pub link: LinkId,
    /// The lanes that it offers.
    pub lanes: u32,
    /// The longest message that it accepts, in units of 1,024 bytes.
    pub max_len: u32,
    /// The number of the publisher.
    pub publisher: u64,
    /// How many messages it has published.
    pub published: u64,
}

impl Open {
    /// The OPEN of an end in this role.
    #[must_use]
    pub const fn new(role: u8, link: LinkId, window: u32) -> Self {
        Self {
            role,
            version: 1,
            window,
            link,
            lanes: 1,
            max_len: if role == role::SENDER { 0 } else { 1 << 20 },
            publisher: 0,
            published: 0,
        }
    }

    /// This OPEN with an offer of the ring lane.
    #[must_use]
    pub const fn with_ring(self) -> Self {
        Self { lanes: 3, ..self }
    }

    /// Returns the bytes of the frame.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        let mut bytes = vec![kind::OPEN, self.role];
        bytes.extend(self.version.to_le_bytes());
        bytes.extend(self.window.to_le_bytes());
        bytes.extend(self.link.epoch.to_le_bytes());
        bytes.extend(self.link.serial.to_le_bytes());
        bytes.extend(self.lanes.to_le_bytes());
        bytes.extend(self.max_len.to_le_bytes());
        bytes.extend(self.publisher.to_le_bytes());
        bytes.extend(self.published.to_le_bytes());
        bytes
    }
}

/// ATTACH.
#[must_use]
pub fn attach(segment: u32, stride: u64, slots: u32) -> Vec<u8> {
    let mut bytes = vec![kind::ATTACH, 0, 0, 0];
    bytes.extend(segment.to_le_bytes());
    bytes.extend(stride.to_le_bytes());
    bytes.extend(slots.to_le_bytes());
    bytes.extend([0; 4]);
    bytes
}

/// DETACH.
#[must_use]
pub fn detach(segment: u32) -> Vec<u8> {
    let mut bytes = vec![kind::DETACH, 0, 0, 0];
    bytes.extend(segment.to_le_bytes());
    bytes
}

/// The header of DATA, REQUEST and REPLY.
#[derive(Clone, Copy, Debug, Default)]
pub struct Head {
    /// DATA, REQUEST or REPLY.
    pub kind: u8,
    /// The payload's form.
    pub form: u8,
    /// The status of a REPLY.
    pub status: u16,
    /// The segment of a pooled payload.
    pub segment: u32,
    /// The slot of a pooled payload.
    pub slot: u32,
    /// Zero.
    pub reserved: u32,
    /// The message's number on this link.
    pub sequence: u64,
    /// The publication's or call's number.
    pub id: u64,
    /// The time of publication, or the deadline.
    pub time: u64,
    /// The payload's length.
    pub len: u64,
}

impl Head {
    /// The `n`th inline message without payload; `id` is also `n`.
    #[must_use]
    pub fn nth(kind: u8, n: u64) -> Self {
        Self {
            kind,
            sequence: n,
            id: n,
            ..Self::default()
        }
    }

    /// Returns the bytes of the header.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        self.with(&[])
    }

    /// Returns the bytes of the header, followed by an inline payload.
    #[must_use]
    pub fn with(self, payload: &[u8]) -> Vec<u8> {
        let mut bytes = vec![self.kind, self.form];
        bytes.extend(self.status.to_le_bytes());
        bytes.extend(self.segment.to_le_bytes());
        bytes.extend(self.slot.to_le_bytes());
        bytes.extend(self.reserved.to_le_bytes());
        for wide in [self.sequence, self.id, self.time, self.len] {
            bytes.extend(wide.to_le_bytes());
        }
        bytes.extend(payload);
        bytes
    }
}

/// A message with an inline payload.
#[must_use]
pub fn inline(kind: u8, n: u64, payload: &[u8]) -> Vec<u8> {
    let head = Head::nth(kind, n);
    let len = payload.len() as u64;
    Head { len, ..head }.with(payload)
}

/// A message in a slot.
#[must_use]
pub fn pooled(kind: u8, n: u64, segment: u32, slot: u32, len: u64) -> Vec<u8> {
    let head = Head::nth(kind, n);
    let form = form::POOLED;
    Head {
        form,
        segment,
        slot,
        len,
        ..head
    }
    .bytes()
}

/// A message in a separate file, which has to be attached.
#[must_use]
pub fn sealed(kind: u8, n: u64, len: u64) -> Vec<u8> {
    let head = Head::nth(kind, n);
    let form = form::SEALED;
    Head { form, len, ..head }.bytes()
}

/// RELEASE; fate 0 is consumed, 1 discarded, 2 expired.
#[must_use]
pub fn release(fate: u8, sequences: &[u64]) -> Vec<u8> {
    let mut bytes = vec![kind::RELEASE, fate];
    bytes.extend((sequences.len() as u16).to_le_bytes());
    bytes.extend([0; 4]);
    for sequence in sequences {
        bytes.extend(sequence.to_le_bytes());
    }
    bytes
}

/// CANCEL.
#[must_use]
pub fn cancel(id: u64) -> Vec<u8> {
    let mut bytes = vec![kind::CANCEL, 0, 0, 0, 0, 0, 0, 0];
    bytes.extend(id.to_le_bytes());
    bytes
}

/// CLOSE.
#[must_use]
pub fn close(code: u16) -> Vec<u8> {
    let mut bytes = vec![kind::CLOSE, 0];
    bytes.extend(code.to_le_bytes());
    bytes.extend([0; 4]);
    bytes
}

/// RING.
#[must_use]
pub fn ring(depth: u16, window: u32) -> Vec<u8> {
    let mut bytes = vec![kind::RING, 0];
    bytes.extend(depth.to_le_bytes());
    bytes.extend(window.to_le_bytes());
    bytes.extend([0; 8]);
    bytes
}

/// DOORBELL.
#[must_use]
pub fn doorbell() -> Vec<u8> {
    vec![kind::DOORBELL, 0, 0, 0, 0, 0, 0, 0]
}

/// ALIVE.
#[must_use]
pub fn alive(time: u64) -> Vec<u8> {
    let mut bytes = vec![kind::ALIVE, 0, 0, 0, 0, 0, 0, 0];
    bytes.extend(time.to_le_bytes());
    bytes
}

/// DETACHED.
#[must_use]
pub fn detached(segment: u32) -> Vec<u8> {
    let mut bytes = vec![kind::DETACHED, 0, 0, 0];
    bytes.extend(segment.to_le_bytes());
    bytes
}

/// The same bytes, with one of them changed.
#[must_use]
pub fn with_byte(mut bytes: Vec<u8>, offset: usize, value: u8) -> Vec<u8> {
    bytes[offset] = value;
    bytes
}
