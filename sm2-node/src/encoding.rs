//! Messages that are encoded and decoded: text, and serde types by postcard or as JSON.

use std::borrow::Cow;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sm2_proto::text::Counted;

use crate::schema::{self, Schema};
use crate::{EncodeError, Message, Payload, PayloadError};

/// Encodes a serde type in the postcard format.
///
/// # Errors
///
/// [`EncodeError`] with the reason from postcard, such as a list of unknown length.
pub fn to_postcard<T: Message + Serialize>(value: &T) -> Result<Cow<'_, [u8]>, EncodeError> {
    match postcard::to_allocvec(value) {
        Ok(bytes) => Ok(Cow::Owned(bytes)),
        Err(error) => Err(EncodeError {
            type_name: T::NAME,
            reason: error.to_string(),
        }),
    }
}

/// Decodes a serde type from the postcard format. All bytes must be used.
///
/// # Errors
///
/// [`PayloadError::Encoding`] if it does not decode, or bytes follow the value.
pub fn from_postcard<T: Message + DeserializeOwned>(
    payload: &Payload,
) -> Result<Box<T>, PayloadError> {
    let broken = |reason| PayloadError::Encoding {
        type_name: T::NAME,
        len: payload.len(),
        reason,
    };
    match postcard::take_from_bytes(payload) {
        Ok((value, [])) => Ok(Box::new(value)),
        Ok((_, rest)) => {
            let rest = Counted::new(rest.len() as u64, "byte");
            Err(broken(format!("{rest} too many")))
        }
        Err(error) => Err(broken(error.to_string())),
    }
}

/// Encodes a serde type as JSON.
///
/// # Errors
///
/// [`EncodeError`] with the reason from serde_json, such as a map whose keys are not text.
#[cfg(feature = "json")]
pub fn to_json<T: Message + Serialize>(value: &T) -> Result<Cow<'_, [u8]>, EncodeError> {
    match serde_json::to_vec(value) {
        Ok(bytes) => Ok(Cow::Owned(bytes)),
        Err(error) => Err(EncodeError {
            type_name: T::NAME,
            reason: error.to_string(),
        }),
    }
}

/// Decodes a serde type from JSON. Only white space may follow it.
///
/// # Errors
///
/// [`PayloadError::Encoding`] if it does not decode, or more than white space follows.
#[cfg(feature = "json")]
pub fn from_json<T: Message + DeserializeOwned>(payload: &Payload) -> Result<Box<T>, PayloadError> {
    serde_json::from_slice(payload).map_err(|error| PayloadError::Encoding {
        type_name: T::NAME,
        len: payload.len(),
        reason: error.to_string(),
    })
}

/// Text in UTF-8. A sample holds a copy, because the slot could change after the check for UTF-8.
impl Message for str {
    const NAME: &'static str = "text";
    const HASH: u64 = schema::message("plain", <Self as Schema>::HASH);
    type View = Box<Self>;

    fn schema() -> Option<String> {
        schema::message_text::<Self>("plain")
    }

    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError> {
        Ok(Cow::Borrowed(self.as_bytes()))
    }

    fn view(payload: Payload) -> Result<Box<Self>, PayloadError> {
        text(payload).map(String::into_boxed_str)
    }
}

/// The same type as `str`.
impl Message for String {
    const NAME: &'static str = str::NAME;
    const HASH: u64 = <str as Message>::HASH;
    type View = Box<Self>;

    fn schema() -> Option<String> {
        schema::message_text::<Self>("plain")
    }

    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError> {
        Ok(Cow::Borrowed(self.as_bytes()))
    }

    fn view(payload: Payload) -> Result<Box<Self>, PayloadError> {
        text(payload).map(Box::new)
    }
}

fn text(payload: Payload) -> Result<String, PayloadError> {
    String::from_utf8(payload.into_vec()).map_err(|error| PayloadError::Encoding {
        type_name: str::NAME,
        len: error.as_bytes().len(),
        reason: error.utf8_error().to_string(),
    })
}
