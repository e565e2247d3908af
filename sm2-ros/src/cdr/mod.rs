//! CDR of types that are known at compile time: the runtime of the code that `sm2-ros-build` generates.
//!
//! [`to_vec`] and [`from_slice`] are for programs. [`Writer`] and [`Reader`] are for generated code, and for types that
//! implement [`Cdr`] by hand.
//!
//! Messages are written little-endian, and read in both byte orders. Reading does not panic on any bytes. It copies out
//! of its [`Source`] and checks the copy, so a source may change meanwhile. The memory for a message is at most a few
//! times as large as its bytes.
//!
//! # Why no crate for CDR
//!
//! The crates for CDR that we know are codecs of serde between Rust types and byte slices, which do not meet four
//! needs:
//!
//! - A publisher learns the length first (`encoded_len`) and then encodes into the shared slot, so the message is never
//!   in a buffer of its own.
//! - A subscriber decodes from memory that the publisher can still change, so the reader takes a [`Source`] that only
//!   copies, instead of a slice, and checks the copies.
//! - Tools encode and decode by definitions that they get at run time, with the same rules of alignment. Serde has no
//!   path to the field that is wrong.
//! - Bytes can come from hostile peers: each length is compared with the bytes that remain before memory is allocated,
//!   and limits such as `string<=5` are checked in both directions.
//!
//! The comparison with `rosbags` (`.ci/run ros`) gives the trust in the bytes that an existing crate would have given.

mod number;
mod numbers;
mod reader;
mod source;
mod writer;

pub use number::Number;
pub use numbers::Numbers;
pub use reader::Reader;
pub use source::Source;
pub(crate) use writer::HEADER_BYTES;
use writer::Rest;
pub use writer::{Discard, Sink, Writer};

use crate::{DecodeError, EncodeError};

/// A structure that has an encoding in CDR.
pub trait Cdr: Sized {
    /// The least number of bytes of a value, without alignment. At least 1.
    const MIN_BYTES: usize;

    /// Writes the fields.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Limit`] with the path to a text or sequence that is longer than its definition allows.
    fn write<S: Sink>(&self, writer: &mut Writer<S>) -> Result<(), EncodeError>;

    /// Reads the fields.
    ///
    /// # Errors
    ///
    /// [`DecodeError::Value`] with the path to the field whose bytes are wrong.
    fn read<S: Source>(reader: &mut Reader<S>) -> Result<Self, DecodeError>;
}

/// Returns the length of a message, in bytes. Takes no time for the elements of number sequences.
///
/// # Errors
///
/// As [`Cdr::write`].
pub fn encoded_len<T: Cdr>(message: &T) -> Result<usize, EncodeError> {
    let mut writer = Writer::new(Discard);
    message.write(&mut writer)?;
    Ok(writer.len_bytes())
}

/// Encodes a message.
///
/// # Errors
///
/// As [`Cdr::write`].
pub fn to_vec<T: Cdr>(message: &T) -> Result<Vec<u8>, EncodeError> {
    let mut writer = Writer::new(Vec::with_capacity(encoded_len(message)?));
    message.write(&mut writer)?;
    Ok(writer.into_sink())
}

/// Encodes a message into `bytes`, which are as long as [`encoded_len`] says.
///
/// # Errors
///
/// As [`Cdr::write`], and [`EncodeError::Room`] if `bytes` have another length.
pub fn write_into<T: Cdr>(message: &T, bytes: &mut [u8]) -> Result<(), EncodeError> {
    let room = bytes.len();
    let mut writer = Writer::new(Rest(bytes));
    message.write(&mut writer)?;
    match writer.len_bytes() {
        len if len == room => Ok(()),
        len => Err(EncodeError::Room { len, room }),
    }
}

/// Decodes a message.
///
/// # Errors
///
/// [`DecodeError::Value`] with the path to the field whose bytes are wrong.
pub fn from_slice<T: Cdr>(bytes: &[u8]) -> Result<T, DecodeError> {
    from_source(bytes)
}

/// Decodes a message that is copied out of its source.
///
/// # Errors
///
/// As [`from_slice`].
pub fn from_source<T: Cdr>(source: impl Source) -> Result<T, DecodeError> {
    let mut reader = Reader::new(source)?;
    let message = T::read(&mut reader)?;
    reader.end()?;
    Ok(message)
}
