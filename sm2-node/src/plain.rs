//! Plain old data: types that are read where the sender wrote them.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::buffer::AlignedBuffer;
use crate::payload::MessageBytes;
use crate::schema::{self, Schema};
use crate::{EncodeError, Message, Payload, PayloadError};

/// A type whose bytes are the message: every bit pattern is a value, and there is no padding. zerocopy's
/// derives prove both; a field that is a `bool`, a reference or an enumeration does not compile.
///
/// Derived by `#[derive(Message)]`: see [`Message`]. The alignment is at most 64 bytes.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not plain old data",
    note = "derive `Message`, and zerocopy's `FromBytes`, `IntoBytes`, `Immutable` and `KnownLayout`"
)]
pub trait Plain:
    FromBytes + IntoBytes + Immutable + KnownLayout + Schema + Send + Sync + 'static
{
    /// The type's name: see [`Message::NAME`].
    const NAME: &'static str;
    /// The hash of the type's structure and encoding: see [`Message::HASH`].
    #[doc(hidden)]
    const PLAIN_HASH: u64 = schema::message("plain", <Self as Schema>::HASH);
    /// Name and hash of a list of this type.
    #[doc(hidden)]
    const LIST: (&'static str, u64) = (
        ListName::<Self>::TEXT,
        schema::message("plain", schema::list(<Self as Schema>::HASH)),
    );
}

impl<T: Plain + ?Sized> Message for T {
    const NAME: &'static str = <T as Plain>::NAME;
    const HASH: u64 = T::PLAIN_HASH;
    type View = InPlace<T>;

    fn schema() -> Option<String> {
        schema::message_text::<Self>("plain")
    }

    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError> {
        Ok(Cow::Borrowed(self.as_bytes()))
    }

    fn view(payload: Payload) -> Result<InPlace<T>, PayloadError> {
        InPlace::new(MessageBytes::Stable(payload))
    }

    #[inline]
    fn view_in_place(bytes: MessageBytes) -> Result<InPlace<T>, PayloadError> {
        InPlace::new(bytes)
    }
}

macro_rules! numbers {
    ($($type:ty = $name:literal),*) => {
        $(impl Plain for $type { const NAME: &'static str = $name; })*
    };
}

numbers! {
    u16 = "u16", u32 = "u32", u64 = "u64", u128 = "u128",
    i8 = "i8", i16 = "i16", i32 = "i32", i64 = "i64", i128 = "i128",
    f32 = "f32", f64 = "f64", () = "empty"
}

impl Plain for u8 {
    const NAME: &'static str = "u8";
    //= SM2-NAM-003
    const LIST: (&'static str, u64) = ("bytes", 0);
}

/// The name is that of the elements with a suffix, such as `f32-list`; a list of `u8` is the type `bytes`.
impl<T: Plain> Plain for [T] {
    const NAME: &'static str = T::LIST.0;
    const PLAIN_HASH: u64 = T::LIST.1;
}

/// `T::NAME` with a suffix, concatenated at compile time.
struct ListName<T: ?Sized>(PhantomData<T>);

impl<T: Plain + ?Sized> ListName<T> {
    const SUFFIX: &'static str = "-list";
    const LEN: usize = <T as Plain>::NAME.len() + Self::SUFFIX.len();
    /// Longer names are cut here; declaring them fails.
    const BYTES: [u8; 512] = {
        let mut bytes = [b'-'; 512];
        let parts = [<T as Plain>::NAME.as_bytes(), Self::SUFFIX.as_bytes()];
        let (mut part, mut at, mut to) = (0, 0, 0);
        while part < parts.len() && to < bytes.len() {
            if at == parts[part].len() {
                (part, at) = (part + 1, 0);
            } else {
                bytes[to] = parts[part][at];
                (at, to) = (at + 1, to + 1);
            }
        }
        bytes
    };
    const TEXT: &'static str = {
        let (text, _) = Self::BYTES.split_at(Self::LEN);
        match std::str::from_utf8(text) {
            Ok(text) => text,
            Err(_) => panic!("the concatenation of two strings is UTF-8"),
        }
    };
}

/// Access to a message of a [`Plain`] type.
///
/// The message is in place, unless its memory is not aligned for the type: then it is a copy.
pub struct InPlace<T: Plain + ?Sized> {
    bytes: Place,
    shows: PhantomData<T>,
}

enum Place {
    Received(MessageBytes),
    Copied(AlignedBuffer),
}

impl<T: Plain + ?Sized> InPlace<T> {
    #[inline]
    fn new(received: MessageBytes) -> Result<Self, PayloadError> {
        let bytes = match check::<T>(&received) {
            Ok(()) => Place::Received(received),
            Err(PayloadError::Alignment { .. }) => {
                let copy = AlignedBuffer::copy_of(&received);
                check::<T>(copy.as_slice())?;
                Place::Copied(copy)
            }
            Err(error) => return Err(error),
        };
        Ok(Self {
            bytes,
            shows: PhantomData,
        })
    }
}

impl Place {
    fn as_slice(&self) -> &[u8] {
        match self {
            Self::Received(bytes) => bytes,
            Self::Copied(buffer) => buffer.as_slice(),
        }
    }
}

/// Checks whether `bytes` have the length and the alignment of a `T`.
pub(crate) fn check<T: Plain + ?Sized>(bytes: &[u8]) -> Result<(), PayloadError> {
    let type_name = <T as Plain>::NAME;
    match T::ref_from_bytes(bytes) {
        Ok(_) => Ok(()),
        Err(zerocopy::CastError::Alignment(_)) => Err(PayloadError::Alignment { type_name }),
        Err(zerocopy::CastError::Size(_)) => Err(PayloadError::Length {
            type_name,
            len: bytes.len(),
        }),
    }
}

/// Returns the length in bytes of a `T` that ends in `count` elements.
pub(crate) fn size_for<T>(count: usize) -> Option<usize>
where
    T: Plain + ?Sized + KnownLayout<PointerMetadata = usize>,
{
    T::size_for_metadata(count)
}

impl<T: Plain + ?Sized> Deref for InPlace<T> {
    type Target = T;

    fn deref(&self) -> &T {
        match T::ref_from_bytes(self.bytes.as_slice()) {
            Ok(value) => value,
            Err(_) => unreachable!("length and alignment were checked and do not change"),
        }
    }
}

impl<T: Plain + ?Sized + fmt::Debug> fmt::Debug for InPlace<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}
