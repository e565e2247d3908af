//! What can be sent: the [`Message`] trait.

use std::borrow::Cow;
use std::ops::Deref;

use sm2_proto::{Name, TypeId};

use crate::Payload;
use crate::payload::MessageBytes;

/// A type that topics and services carry.
///
/// | type | how it travels | how it is received |
/// | --- | --- | --- |
/// | `[u8]` | as it is; type `bytes`, the raw messages of SM2-NAM-003 | in place |
/// | [`Plain`](crate::Plain) types, numbers, slices of them | as they are in memory | in place |
/// | `str`, `String` | UTF-8 | copied and checked |
/// | serde types | postcard or JSON | decoded |
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
/// So is a header that is followed by as many elements as the message has. There must be no
/// padding for any number of them, so the header's numbers are ones without alignment (or
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
/// Anything that serde can encode:
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
/// With `encoding = "json"` and the feature `json` it travels as JSON: several times slower and
/// longer, but read by whatever knows neither SM2's types nor postcard. JSON has no `NaN` and
/// no infinity: such a number arrives as an error.
///
/// The derives of zerocopy and serde need these crates in your `Cargo.toml`. The name
/// follows SM2-NAM-001: segments of `A-Z a-z 0-9 _ -`, joined by single `/`.
///
/// What cannot be right does not compile: a field that not every bit pattern is a value of,
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
/// a name that is none, a type without a name,
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
/// or an encoding that differs from what the schema says.
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
/// Implement it by hand for another encoding: `bytes` and `view` are all there is to it. With
/// [`schema::message_text`](crate::schema::message_text) tools at least learn its structure.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a message",
    note = "derive it, with zerocopy's traits or serde's beside it: see `sm2_node::Message`",
    note = "a list is sent as a slice: `[T]`, not `Vec<T>`"
)]
pub trait Message: 'static {
    /// The type's name, the same in every program and language.
    const NAME: &'static str;
    /// The hash of structure and encoding: see [`schema`](crate::schema).
    const HASH: u64;
    /// What a [`Sample`](crate::Sample) holds to show the message.
    type View: Deref<Target = Self> + Send + Sync;

    /// The schema text, from which tools know what the bytes mean and whose hash is
    /// [`HASH`](Self::HASH): SPEC Annex A. A type whose hash was chosen by hand has none.
    #[must_use]
    fn schema() -> Option<String> {
        None
    }

    /// The message as bytes.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] if this value has no encoding.
    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError>;

    /// The message that these bytes are.
    ///
    /// # Errors
    ///
    /// [`PayloadError`] if they are none.
    fn view(payload: Payload) -> Result<Self::View, PayloadError>;

    /// As [`view`](Self::view), for a type that is read where the sender wrote it: the result may
    /// refer to a slot, which the caller releases only after it dropped the result.
    #[doc(hidden)]
    #[inline]
    fn view_in_place(bytes: MessageBytes) -> Result<Self::View, PayloadError> {
        Self::view(bytes.into_payload())
    }

    /// The type as it is declared to the Manager.
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

/// A value that its encoding cannot express.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a value of type {type_name} cannot be encoded: {reason}")]
pub struct EncodeError {
    /// The message type.
    pub type_name: &'static str,
    /// What the encoding says.
    pub reason: String,
}

/// Bytes that are not a message of the type that was declared: its sender does
/// not send what it declared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PayloadError {
    /// The length does not fit the type.
    #[error("{len} bytes are not a message of type {type_name}: check who publishes it")]
    Length {
        /// The message type.
        type_name: &'static str,
        /// How many bytes came.
        len: usize,
    },
    /// The type demands an alignment of more than 64 bytes.
    #[error("{type_name} demands an alignment of more than 64 bytes: lower its repr(align)")]
    Alignment {
        /// The message type.
        type_name: &'static str,
    },
    /// The bytes do not decode.
    #[error("{len} bytes are not a message of type {type_name}: {reason}")]
    Encoding {
        /// The message type.
        type_name: &'static str,
        /// How many bytes came.
        len: usize,
        /// What the decoder says.
        reason: String,
    },
}
