//! Messages before they are stored.

use std::borrow::Cow;
use std::fmt;
use std::os::fd::OwnedFd;

use bytes::Bytes;
use sm2_io::Preallocated;

use crate::spare::{self, Fill};
use crate::{EncodeError, Message, StoreError};

/// Messages of up to this length are copied under the node's lock, because taking the lock a second
/// time would take longer than the copy.
pub(crate) const COPY_UNDER_LOCK_MAX: usize = 16 << 10;

/// A message that is to be stored.
pub(crate) enum Outgoing<'a> {
    /// Its bytes.
    Encoded(Cow<'a, [u8]>),
    /// A long message that encodes itself into the memory that its receivers read. `encode` may be called more than
    /// once.
    InPlace { len: usize, encode: Encode<'a> },
}

type Encode<'a> = Box<dyn Fn(&mut [u8]) -> Result<(), EncodeError> + 'a>;

impl<'a> Outgoing<'a> {
    /// Encodes a message now, or prepares for it if the message is long and can be encoded in place.
    #[inline]
    pub(crate) fn new<T: Message + ?Sized>(message: &'a T) -> Result<Self, EncodeError> {
        match message.encoded_len() {
            Some(len) if len > COPY_UNDER_LOCK_MAX => Ok(Self::InPlace {
                len,
                encode: Box::new(|bytes| message.encode_into(bytes)),
            }),
            _ => message.bytes().map(Self::Encoded),
        }
    }

    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Encoded(bytes) => bytes.len(),
            Self::InPlace { len, .. } => *len,
        }
    }

    /// Writes the message to a slot, whose length is that of the message.
    pub(crate) fn write_to(&self, slot: &mut [u8]) -> Result<(), EncodeError> {
        match self {
            Self::Encoded(bytes) => {
                slot.copy_from_slice(bytes);
                Ok(())
            }
            Self::InPlace { encode, .. } => encode(slot),
        }
    }

    /// Writes the message to a sealed file.
    pub(crate) fn seal(
        &self,
        spare: impl FnOnce(usize, Fill) -> Option<Preallocated>,
    ) -> Result<OwnedFd, StoreError> {
        match self {
            Self::Encoded(bytes) => spare::seal(spare(bytes.len(), Fill::Copy), bytes),
            Self::InPlace { len, encode } => {
                let mut loan =
                    spare::lend(spare(*len, Fill::InPlace), *len).map_err(StoreError::Io)?;
                encode(loan.as_mut_slice()).map_err(StoreError::Encode)?;
                loan.seal()
            }
        }
        .map_err(StoreError::Io)
    }

    /// Returns the message in private memory.
    pub(crate) fn into_bytes(self) -> Result<Bytes, EncodeError> {
        match self {
            Self::Encoded(Cow::Borrowed(bytes)) => Ok(Bytes::copy_from_slice(bytes)),
            Self::Encoded(Cow::Owned(bytes)) => Ok(bytes.into()),
            Self::InPlace { len, encode } => {
                let mut bytes = vec![0; len];
                encode(&mut bytes)?;
                Ok(bytes.into())
            }
        }
    }
}

impl<'a> From<&'a [u8]> for Outgoing<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self::Encoded(Cow::Borrowed(bytes))
    }
}

impl fmt::Debug for Outgoing<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Outgoing({} bytes)", self.len())
    }
}
