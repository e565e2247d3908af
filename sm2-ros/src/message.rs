//! Types of ROS 2 as messages of SM2. Only the macro `__message` calls these functions.

use std::borrow::Cow;

use sm2_node::{EncodeError, PayloadError, SharedBytes};

use crate::cdr::{self, Source};
use crate::{DecodeError, Type};

/// Encodes a message.
pub fn bytes<T: Type>(message: &T) -> Result<Cow<'_, [u8]>, EncodeError> {
    cdr::to_vec(message)
        .map(Cow::Owned)
        .map_err(|error| not_encoded::<T>(&error))
}

/// Encodes a message into `bytes`.
pub fn encode_into<T: Type>(message: &T, bytes: &mut [u8]) -> Result<(), EncodeError> {
    cdr::write_into(message, bytes).map_err(|error| not_encoded::<T>(&error))
}

fn not_encoded<T: Type>(error: &crate::EncodeError) -> EncodeError {
    EncodeError {
        type_name: T::TYPE_NAME,
        reason: error.to_string(),
    }
}

/// Decodes a message that is in private memory.
pub fn view<T: Type>(payload: &[u8]) -> Result<Box<T>, PayloadError> {
    decoded(payload.len(), cdr::from_slice(payload))
}

/// Decodes a message that is copied out of the memory of its publisher.
pub fn decode<T: Type>(bytes: &SharedBytes<'_>) -> Result<Box<T>, PayloadError> {
    decoded(bytes.len(), cdr::from_source(Shared(bytes)))
}

fn decoded<T: Type>(len: usize, message: Result<T, DecodeError>) -> Result<Box<T>, PayloadError> {
    message
        .map(Box::new)
        .map_err(|error| PayloadError::Encoding {
            type_name: T::TYPE_NAME,
            len,
            reason: error.to_string(),
        })
}

struct Shared<'a>(&'a SharedBytes<'a>);

impl Source for Shared<'_> {
    #[inline]
    fn len(&self) -> usize {
        self.0.len()
    }

    #[inline]
    fn copy_to(&self, at: usize, to: &mut [u8]) -> bool {
        self.0.copy_to(at, to)
    }

    fn to_vec(&self, at: usize, len: usize) -> Option<Vec<u8>> {
        self.0.to_vec(at, len)
    }
}

/// Implements `sm2_node::Message` for a generated type.
#[doc(hidden)]
#[macro_export]
macro_rules! __message {
    ($type:ty) => {
        impl $crate::sm2_node::Message for $type {
            const NAME: &'static str = <Self as $crate::Type>::TYPE_NAME;
            const HASH: u64 = $crate::sm2_node::schema::cdr(&<Self as $crate::Type>::RIHS01);
            type View = ::std::boxed::Box<Self>;

            fn schema() -> ::core::option::Option<::std::string::String> {
                ::core::option::Option::Some(<Self as $crate::Type>::SCHEMA.into())
            }

            fn bytes(
                &self,
            ) -> ::core::result::Result<::std::borrow::Cow<'_, [u8]>, $crate::sm2_node::EncodeError>
            {
                $crate::message::bytes(self)
            }

            fn encoded_len(&self) -> ::core::option::Option<usize> {
                $crate::cdr::encoded_len(self).ok()
            }

            fn encode_into(
                &self,
                bytes: &mut [u8],
            ) -> ::core::result::Result<(), $crate::sm2_node::EncodeError> {
                $crate::message::encode_into(self, bytes)
            }

            fn view(
                payload: $crate::sm2_node::Payload,
            ) -> ::core::result::Result<Self::View, $crate::sm2_node::PayloadError> {
                $crate::message::view(&payload)
            }

            fn decode(
                bytes: &$crate::sm2_node::SharedBytes<'_>,
            ) -> ::core::option::Option<
                ::core::result::Result<Self::View, $crate::sm2_node::PayloadError>,
            > {
                ::core::option::Option::Some($crate::message::decode(bytes))
            }
        }
    };
}
