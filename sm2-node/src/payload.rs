//! The bytes of one received message, wherever they are.

use std::fmt;
use std::io;
use std::ops::Deref;
use std::sync::Arc;

use bytes::Bytes;
use sm2_io::memfd::SealedFile;
use sm2_io::{PooledMapping, SealedMapping};

use crate::pooled::PooledBytes;

/// The bytes of one received message, in memory that no process can change: private memory, or a
/// sealed file of their own. Dereferences to the bytes.
///
/// A message that came in a slot of its publisher's pool was copied. Plain old data is read in the
/// slot instead, and never takes this form: see [`Message`](crate::Message).
pub struct Payload(Storage);

enum Storage {
    Inline(Bytes),
    Sealed(SealedMapping),
    Copied(Vec<u8>),
}

impl Payload {
    pub(crate) const fn inline(bytes: Bytes) -> Self {
        Self(Storage::Inline(bytes))
    }

    /// The bytes in a vector of their own, without a copy if they are in one already.
    pub(crate) fn into_vec(self) -> Vec<u8> {
        match self.0 {
            Storage::Copied(bytes) => bytes,
            Storage::Inline(_) | Storage::Sealed(_) => self.to_vec(),
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
            Storage::Inline(bytes) => bytes,
            Storage::Sealed(mapping) => mapping,
            Storage::Copied(bytes) => bytes,
        }
    }
}

impl fmt::Debug for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let form = match self.0 {
            Storage::Inline(_) => "inline",
            Storage::Sealed(_) => "sealed",
            Storage::Copied(_) => "copied",
        };
        write!(f, "Payload({form}, {} bytes)", self.len())
    }
}

/// The bytes of a message that the program holds, where the sender put them.
///
/// The slice over a slot is valid only until the message is given back, so this type stays inside
/// the crate: [`Message::view`](crate::Message::view) gets a [`Payload`] instead.
#[derive(Debug)]
pub enum MessageBytes {
    Stable(Payload),
    Pooled(PooledBytes),
}

impl MessageBytes {
    /// The bytes in memory that no process can change: a copy of those in a slot.
    pub(crate) fn into_payload(self) -> Payload {
        match self {
            Self::Stable(payload) => payload,
            Self::Pooled(bytes) => Payload(Storage::Copied(bytes.copy())),
        }
    }
}

impl Deref for MessageBytes {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        match self {
            Self::Stable(payload) => payload,
            Self::Pooled(bytes) => bytes,
        }
    }
}

/// Where the bytes of a message are that was taken from its link.
#[derive(Debug)]
pub(crate) enum Source {
    Inline(Bytes),
    /// `len` bytes at `offset` of a segment.
    Pooled {
        segment: Arc<PooledMapping>,
        offset: u64,
        len: u64,
    },
    /// In a sealed file that is not mapped yet: that takes long for large ones, and is not
    /// done under the node's lock.
    Sealed {
        file: SealedFile,
        len: u64,
    },
    /// Its segment or file is not known. No machine lets such a message pass.
    Missing,
}

impl Source {
    /// Makes the bytes readable.
    ///
    /// # Safety
    ///
    /// As [`PooledBytes::new`]: the message is not released before the result is dropped.
    //= SM2-PAY-006
    // `offset` and `len` are what the link's machine made of the datagram, or of its copy of the
    // head; nothing here was read from shared memory.
    #[allow(unsafe_code, reason = "passes the condition of `PooledBytes::new` on")]
    #[inline]
    pub(crate) unsafe fn open(self) -> io::Result<MessageBytes> {
        match self {
            Self::Inline(bytes) => Ok(MessageBytes::Stable(Payload::inline(bytes))),
            Self::Pooled {
                segment,
                offset,
                len,
            } => {
                // SAFETY: the caller's promise is the same.
                let bytes = unsafe { PooledBytes::new(segment, offset, len) };
                let bytes = bytes.ok_or(io::ErrorKind::NotFound)?;
                Ok(MessageBytes::Pooled(bytes))
            }
            // All pages at once: a program that takes a message is about to read it.
            Self::Sealed { file, len } => {
                let mapping = SealedMapping::new(&file, len, true)?;
                Ok(MessageBytes::Stable(Payload(Storage::Sealed(mapping))))
            }
            Self::Missing => Err(io::ErrorKind::NotFound.into()),
        }
    }
}
