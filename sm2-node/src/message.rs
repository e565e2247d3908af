//! The [`Message`] trait: types that can be sent.

use std::borrow::Cow;
use std::ops::Deref;

use sm2_proto::text::Counted;
use sm2_proto::{Name, TypeId};

use crate::Payload;
use crate::payload::{MessageBytes, SharedBytes};

/// A type that topics and services can carry.
///
/// | type | encoding | the receiver gets |
/// | --- | --- | --- |
/// | `[u8]` | none; type `bytes`, the raw messages of SM2-NAM-003 | the bytes in place |
/// | [`Plain`](crate::Plain) types, numbers, slices of them | none: the bytes in memory | the value in place |
/// | `str`, `String` | UTF-8 | a checked copy |
/// | serde types | postcard or JSON | the decoded value |
///
/// Plain old data is read where the sender wrote it, so it costs the same for any size:
///
/// ```
/// use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
/// use sm2_node::Message;
///
/// #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
/// #[message(name = "sensor/Imu")]
/// #[repr(C)]
/// struct Imu {
///     stamp_ns: u64,
///     acceleration: [f64; 3],
/// }
/// ```
///
/// A structure may end in a slice: a header, followed by as many elements as the message has. There must be
/// no padding for any number of elements. The numbers of the header are therefore types without alignment (or
/// the structure is `repr(C, packed)`):
///
/// ```
/// # use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
/// # use sm2_node::Message;
/// use sm2_node::zerocopy::little_endian::U32;
///
/// #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
/// #[message(name = "sensor/Image")]
/// #[repr(C)]
/// struct Image {
///     width: U32,
///     height: U32,
///     pixels: [u8],
/// }
/// ```
///
/// Any type that serde can encode can be a message:
///
/// ```
/// # use sm2_node::Message;
/// use serde::{Deserialize, Serialize};
///
/// #[derive(Message, Serialize, Deserialize)]
/// #[message(name = "nav/Path", encoding = "postcard")]
/// struct Path {
///     frame: String,
///     points: Vec<(f64, f64)>,
/// }
/// ```
///
/// With `encoding = "json"` and the feature `json`, messages are sent as JSON. They are several times longer
/// and slower, but a reader needs to know neither SM2's types nor postcard. JSON has no `NaN` and no
/// infinity: such a number arrives as an error.
///
/// The derives of zerocopy and serde need these crates in your `Cargo.toml`. The name
/// follows SM2-NAM-001: segments of `A-Z a-z 0-9 _ -`, joined by single `/`.
///
/// Mistakes do not compile. One is a field with bit patterns that are not values:
///
/// ```compile_fail,E0277
/// # use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
/// # use sm2_node::Message;
/// #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
/// #[message(name = "robot/Brake")]
/// #[repr(C)]
/// struct Brake {
///     engaged: bool,
/// }
/// ```
///
/// Others are an illegal name, or a missing name,
///
/// ```compile_fail
/// # use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
/// # use sm2_node::Message;
/// #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
/// #[message(name = "robot::Brake")]
/// #[repr(C)]
/// struct Brake {
///     force: f64,
/// }
/// ```
///
/// and an encoding that differs from the schema:
///
/// ```compile_fail
/// # use sm2_node::Message;
/// # use serde::{Deserialize, Serialize};
/// #[derive(Message, Serialize, Deserialize)]
/// #[message(name = "nav/Goal", encoding = "postcard")]
/// struct Goal {
///     position: (f64, f64),
///     #[serde(skip)]
///     note: String,
/// }
/// ```
///
/// Implement this trait by hand for another encoding; `bytes` and `view` are all that it needs. With
/// [`schema::message_text`](crate::schema::message_text), tools can still learn the structure.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a message",
    note = "derive `Message` together with zerocopy's or serde's traits: see `sm2_node::Message`",
    note = "a list is sent as a slice: `[T]`, not `Vec<T>`"
)]
pub trait Message: 'static {
    /// The type's name, the same in every program and language.
    const NAME: &'static str;
    /// The hash of the type's structure and encoding: see [`schema`](crate::schema).
    const HASH: u64;
    /// The part of a [`Sample`](crate::Sample) that gives access to the message.
    type View: Deref<Target = Self> + Send + Sync;

    /// The schema text (SPEC Annex A), which tools need to decode messages. Its hash is [`HASH`](Self::HASH).
    /// `None` for a type whose hash was chosen by hand.
    #[must_use]
    fn schema() -> Option<String> {
        None
    }

    /// Encodes the message.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] if this value has no encoding.
    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError>;

    /// The number of bytes that [`encode_into`](Self::encode_into) writes. `None`, the default, if the length is
    /// unknown before the message is encoded, or if this value has no encoding.
    ///
    /// A type that knows the length is encoded directly into the memory that its receivers read, if it is long.
    #[must_use]
    #[inline]
    fn encoded_len(&self) -> Option<usize> {
        None
    }

    /// Encodes the message into `bytes`, as many as [`encoded_len`](Self::encoded_len) says. Their values are
    /// unspecified before, and all of them are sent.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] if this value has no encoding, or one of another length.
    fn encode_into(&self, bytes: &mut [u8]) -> Result<(), EncodeError> {
        let encoded = self.bytes()?;
        if encoded.len() != bytes.len() {
            let (is, was) = (encoded.len(), bytes.len());
            return Err(EncodeError {
                type_name: Self::NAME,
                reason: format!("it has {is} bytes, but encoded_len returned {was}"),
            });
        }
        bytes.copy_from_slice(&encoded);
        Ok(())
    }

    /// Decodes a message.
    ///
    /// # Errors
    ///
    /// [`PayloadError`] if the bytes are not a message of this type.
    fn view(payload: Payload) -> Result<Self::View, PayloadError>;

    /// Decodes a message by copying its parts out of the memory where its publisher put it. `None`, the default, if the
    /// type needs a [`Payload`]; then [`view`](Self::view) is called, after the whole message was copied if it is in a
    /// slot.
    #[must_use]
    #[inline]
    fn decode(_bytes: &SharedBytes<'_>) -> Option<Result<Self::View, PayloadError>> {
        None
    }

    /// As [`view`](Self::view), for a type that is read in place. The result may refer to a slot, so the
    /// caller must drop the result before it releases the slot.
    #[doc(hidden)]
    #[inline]
    fn view_in_place(bytes: MessageBytes) -> Result<Self::View, PayloadError> {
        match Self::decode(&SharedBytes::new(&bytes)) {
            Some(view) => view,
            None => Self::view(bytes.into_payload()),
        }
    }

    /// Returns the type as it is declared to the Manager.
    ///
    /// # Panics
    ///
    /// If a hand-written [`NAME`](Self::NAME) is not a name (SM2-NAM-001).
    #[must_use]
    fn type_id() -> TypeId {
        match Name::new(Self::NAME) {
            Ok(name) => TypeId {
                name,
                hash: Self::HASH,
            },
            Err(error) => panic!("message type {:?}: {error}", Self::NAME),
        }
    }
}

/// A value that cannot be encoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a value of type {type_name} cannot be encoded: {reason}")]
pub struct EncodeError {
    /// The message type.
    pub type_name: &'static str,
    /// The reason from the encoder.
    pub reason: String,
}

/// Bytes that are not a message of the declared type. The sender does not send what it declared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PayloadError {
    /// The length does not fit the type.
    #[error(
        "a message of type {type_name} cannot have {}: check who publishes it",
        Counted::new(*len as u64, "byte")
    )]
    Length {
        /// The message type.
        type_name: &'static str,
        /// The number of bytes received.
        len: usize,
    },
    /// The type has an alignment of more than 64 bytes.
    #[error("{type_name} has an alignment of more than 64 bytes: lower its repr(align)")]
    Alignment {
        /// The message type.
        type_name: &'static str,
    },
    /// The bytes do not decode.
    #[error(
        "{} cannot be decoded as a message of type {type_name}: {reason}",
        Counted::new(*len as u64, "byte")
    )]
    Encoding {
        /// The message type.
        type_name: &'static str,
        /// The number of bytes received.
        len: usize,
        /// The reason from the decoder.
        reason: String,
    },
}
