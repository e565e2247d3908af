//! One datagram to send.

use core::{fmt, ops::Deref};

use alloc::vec::Vec;

use bytes::Bytes;

use crate::limits::MESSAGE_HEAD;

/// One datagram to send: `head`, then `payload`, with one descriptor or none.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Packet {
    /// The first bytes.
    pub head: Head,
    /// All further bytes; often empty.
    pub payload: Bytes,
    /// The descriptor that is sent with the datagram.
    pub attachment: Option<Attachment>,
}

/// Names the descriptor of the driver's that is sent with a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Attachment {
    /// The descriptor of the segment with this number.
    Segment(u32),
    /// The descriptor of the sealed message with this
    /// [`OutboundMessage::key`](super::OutboundMessage::key).
    Message(u64),
    /// The descriptor of this end's ring: see [`Config::ring`](super::Config::ring).
    Ring,
}

impl Packet {
    pub(super) const fn bare(head: Head) -> Self {
        Self {
            head,
            payload: Bytes::new(),
            attachment: None,
        }
    }

    /// Returns the whole datagram as one vector.
    #[must_use]
    pub fn to_vec(&self) -> Vec<u8> {
        [&self.head[..], &self.payload[..]].concat()
    }

    /// The length of the datagram, in bytes.
    #[must_use]
    pub fn len_bytes(&self) -> usize {
        self.head.len() + self.payload.len()
    }
}

/// The first bytes of a datagram, kept without an allocation.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Head {
    /// The bytes from `len` on are zero.
    bytes: [u8; MESSAGE_HEAD],
    len: u8,
}

impl Head {
    /// Creates a head with these bytes.
    pub(super) fn new<const N: usize>(bytes: &[u8; N]) -> Self {
        const { assert!(N <= MESSAGE_HEAD) };
        let mut head = Self {
            bytes: [0; MESSAGE_HEAD],
            len: N as u8,
        };
        head.bytes[..N].copy_from_slice(bytes);
        head
    }

    /// Appends eight bytes if there is room for them. Returns whether there was.
    pub(super) fn push(&mut self, bytes: [u8; 8]) -> bool {
        let end = self.len + 8;
        match self.bytes.get_mut(usize::from(self.len)..usize::from(end)) {
            Some(room) => {
                room.copy_from_slice(&bytes);
                self.len = end;
                true
            }
            None => false,
        }
    }
}

const _: () = assert!(MESSAGE_HEAD + 8 <= u8::MAX as usize);

impl Deref for Head {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }
}

impl fmt::Debug for Head {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Head").field(&&self[..]).finish()
    }
}
