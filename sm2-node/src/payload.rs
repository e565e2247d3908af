//! The bytes of one received message.

use std::fmt;
use std::io;
use std::ops::Deref;
use std::sync::Arc;

use bytes::Bytes;
use sm2_io::memfd::SealedFile;

use crate::driver::Held;
use crate::pooled::PooledBytes;
use crate::quota::{MappedFile, PeerQuota};

/// The bytes of one received message in memory that no process can change: private memory, or a sealed file.
/// Dereferences to the bytes.
///
/// A message in a slot of its publisher's pool is copied to get this form. Plain old data is read directly in
/// the slot instead: see [`Message`](crate::Message).
pub struct Payload(Storage);

enum Storage {
    Inline(Bytes),
    Sealed(MappedFile),
    Copied(Vec<u8>),
}

impl Payload {
    pub(crate) const fn inline(bytes: Bytes) -> Self {
        Self(Storage::Inline(bytes))
    }

    /// Returns the bytes as a vector, without a copy if they already are in one.
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

/// The bytes of a message that the program holds, in the memory where the sender put them.
///
/// The slice over a slot is valid only until the message is released, so this type is private to the crate:
/// [`Message::view`](crate::Message::view) gets a [`Payload`] instead.
#[derive(Debug)]
pub enum MessageBytes {
    Stable(Payload),
    Pooled(PooledBytes),
}

impl MessageBytes {
    /// Returns the bytes in memory that no process can change. Copies those in a slot.
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

/// The bytes of a received message, which a publisher that breaks the rules may still change. They are copied out part
/// by part: see [`Message::decode`](crate::Message::decode).
///
/// A copy does not change. Therefore, check a copy and not the bytes: read a length once, and compare the copy of the
/// length with [`len`](Self::len).
#[derive(Debug)]
pub struct SharedBytes<'a>(&'a MessageBytes);

impl<'a> SharedBytes<'a> {
    pub(crate) const fn new(bytes: &'a MessageBytes) -> Self {
        Self(bytes)
    }

    /// The length of the message, in bytes.
    #[must_use]
    #[inline]
    pub fn len(&self) -> usize {
        match self.0 {
            MessageBytes::Stable(payload) => payload.len(),
            MessageBytes::Pooled(bytes) => bytes.len(),
        }
    }

    /// Whether the message has no bytes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Copies the bytes from `start` on. Returns false if they are not all inside the message.
    #[must_use]
    #[inline]
    pub fn copy_to(&self, start: usize, to: &mut [u8]) -> bool {
        match self.0 {
            MessageBytes::Pooled(bytes) => bytes.copy_to(start, to),
            MessageBytes::Stable(payload) => {
                match payload.get(start..).and_then(|it| it.get(..to.len())) {
                    Some(bytes) => {
                        to.copy_from_slice(bytes);
                        true
                    }
                    None => false,
                }
            }
        }
    }

    /// Returns a copy of `len` bytes from `start` on; `None` if they are not all inside the message.
    #[must_use]
    pub fn to_vec(&self, start: usize, len: usize) -> Option<Vec<u8>> {
        match self.0 {
            MessageBytes::Pooled(bytes) => bytes.copy_part(start, len),
            MessageBytes::Stable(payload) => {
                let bytes = payload.get(start..)?.get(..len)?;
                Some(bytes.to_vec())
            }
        }
    }
}

/// The location of the bytes of a message that was taken from its link.
#[derive(Debug)]
pub(crate) enum Source {
    Inline(Bytes),
    /// The copy of a cell that the message holds.
    Cell,
    /// `len` bytes at `offset` of the segment that the message holds.
    Pooled {
        offset: u64,
        len: u64,
    },
    /// A sealed file that is not mapped yet. Mapping a large file takes long, so it is done without the
    /// node's lock.
    Sealed {
        file: SealedFile,
        len: u64,
        quota: Arc<PeerQuota>,
    },
    /// An unknown segment or file. The link's machine never delivers such a message.
    Missing,
}

impl Source {
    /// Makes the bytes readable.
    ///
    /// # Safety
    ///
    /// As for [`PooledBytes::new`]: before the result is dropped, the message is not released, nor `held` dropped.
    //= SM2-PAY-006
    // The link's machine took `offset` and `len` from the datagram, or from its copy of the head; neither was
    // read from shared memory here.
    #[allow(unsafe_code, reason = "passes the condition of `PooledBytes::new` on")]
    #[inline]
    pub(crate) unsafe fn open(self, held: &Held) -> io::Result<MessageBytes> {
        match self {
            Self::Inline(bytes) => Ok(MessageBytes::Stable(Payload::inline(bytes))),
            Self::Cell => {
                let Held::Cell(copy) = held else {
                    return Err(io::ErrorKind::NotFound.into());
                };
                // SAFETY: the caller makes the same promise; the copy is not written while `held` holds it.
                Ok(MessageBytes::Pooled(unsafe { PooledBytes::of_copy(copy) }))
            }
            Self::Pooled { offset, len } => {
                let Held::Segment(segment) = held else {
                    return Err(io::ErrorKind::NotFound.into());
                };
                // SAFETY: the caller makes the same promise; `held` keeps the segment mapped.
                let bytes = unsafe { PooledBytes::new(&segment.mapping, offset, len) };
                let bytes = bytes.ok_or(io::ErrorKind::NotFound)?;
                Ok(MessageBytes::Pooled(bytes))
            }
            // Maps all pages at once: a program that takes a message will read it.
            Self::Sealed { file, len, quota } => {
                let mapping = MappedFile::new(&file, len, &quota)?;
                Ok(MessageBytes::Stable(Payload(Storage::Sealed(mapping))))
            }
            Self::Missing => Err(io::ErrorKind::NotFound.into()),
        }
    }
}
