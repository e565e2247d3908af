//! The bytes of one received message, wherever they are.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;

use bytes::Bytes;
use sm2_io::Mapping;

/// The bytes of one received message: in private memory, in a sealed file of their
/// own, or in a slot of a segment that the sender reuses later.
///
/// Dereferences to the bytes where they are. Those of a slot are meant to stay as
/// they are until the message is given back, but a sender that breaks the
/// specification can change them: read them in place only as types for which every
/// bit pattern is a value, and [`stable`](Self::stable) where a check and a
/// use must see the same.
pub struct Payload(Place);

enum Place {
    Inline(Bytes),
    /// `len` bytes at `offset`, inside the mapping.
    Pooled {
        segment: Arc<Mapping>,
        offset: u64,
        len: u64,
    },
    Sealed(Mapping),
}

impl Payload {
    pub(crate) const fn inline(bytes: Bytes) -> Self {
        Self(Place::Inline(bytes))
    }

    /// `None` if the bytes are not all inside the mapping.
    //= SM2-PAY-006
    // `offset` and `len` are what the link's machine made of the datagram; nothing here was
    // read from shared memory.
    pub(crate) fn pooled(segment: Arc<Mapping>, offset: u64, len: u64) -> Option<Self> {
        segment.bytes(offset, len)?;
        Some(Self(Place::Pooled {
            segment,
            offset,
            len,
        }))
    }

    const fn sealed(mapping: Mapping) -> Self {
        Self(Place::Sealed(mapping))
    }

    /// The bytes in memory that nobody can change: where they are if they came inline or
    /// sealed, and a copy of them if they are in a slot.
    #[must_use]
    pub fn stable(&self) -> Cow<'_, [u8]> {
        match self.0 {
            Place::Inline(_) | Place::Sealed(_) => Cow::Borrowed(self),
            Place::Pooled { .. } => Cow::Owned(self.to_vec()),
        }
    }
}

/// Where the bytes of a message are that was taken from its link.
#[derive(Debug)]
pub(crate) enum Source {
    Ready(Payload),
    /// In a sealed file that is not mapped yet: that takes long for large ones, and is not
    /// done under the node's lock.
    Sealed {
        file: OwnedFd,
        len: u64,
    },
    /// Its segment or file is not known. No machine lets such a message pass.
    Missing,
}

impl Source {
    /// Maps what is to be mapped.
    //= SM2-PAY-007
    pub(crate) fn open(self) -> io::Result<Payload> {
        match self {
            Self::Ready(payload) => Ok(payload),
            // All pages at once: whoever takes a message is about to read it.
            Self::Sealed { file, len } => {
                Mapping::read_only(file.as_fd(), len, true).map(Payload::sealed)
            }
            Self::Missing => Err(io::ErrorKind::NotFound.into()),
        }
    }
}

impl<B: Into<Bytes>> From<B> for Payload {
    fn from(bytes: B) -> Self {
        Self::inline(bytes.into())
    }
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.0 {
            Place::Inline(bytes) => bytes,
            Place::Sealed(mapping) => mapping.as_slice(),
            Place::Pooled {
                segment,
                offset,
                len,
            } => segment
                .bytes(*offset, *len)
                .expect("checked when it was made; a mapping never shrinks"),
        }
    }
}

impl fmt::Debug for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let form = match self.0 {
            Place::Inline(_) => "inline",
            Place::Pooled { .. } => "pooled",
            Place::Sealed(_) => "sealed",
        };
        write!(f, "Payload({form}, {} bytes)", self.len())
    }
}
