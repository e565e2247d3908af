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
    /// The descriptor that comes along.
    pub attachment: Option<Attachment>,
}

/// Which descriptor of the driver's a packet takes along.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Attachment {
    /// That of the segment with this number.
    Segment(u32),
    /// That of the sealed message with this [`OutboundMessage::key`](super::OutboundMessage::key).
    Message(u64),
    /// That of the ring which [`Output::MakeRing`](super::Output::MakeRing) asked for.
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

    /// The whole datagram in one piece.
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
    /// What is beyond `len` is zero.
    bytes: [u8; MESSAGE_HEAD],
    len: u8,
}

impl Head {
    /// A head with these bytes.
    pub(super) fn new<const N: usize>(bytes: &[u8; N]) -> Self {
        const { assert!(N <= MESSAGE_HEAD) };
        let mut head = Self {
            bytes: [0; MESSAGE_HEAD],
            len: N as u8,
        };
        head.bytes[..N].copy_from_slice(bytes);
        head
    }

    /// Adds eight bytes; whether there was room for them.
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
