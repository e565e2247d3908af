//! Messages of ROS 2: their bytes in CDR, read and written by the definitions of their types.
//!
//! [`decode`] turns the bytes of a message into a [`Value`] with the names of its fields, and [`encode`] turns
//! JSON into bytes. Both need only the definition of the type, as [`sm2_ros_idl::Set`] holds it, so tools work
//! with types that they were not built with. [`place`] reads single fields.
//!
//! CDR is the encoding that ROS 2 uses on the wire and in bags: XCDR version 1. A message begins with four
//! bytes; the second one says the byte order (0 big-endian, 1 little-endian). Each number is aligned to
//! its size, counted from the fifth byte. A text and a sequence begin with their length in 32 bits.
//!
//! Bytes can come from hostile peers. Decoding does not panic, and every length is compared with the bytes that
//! remain before memory is allocated for it.
#![forbid(unsafe_code)]

// For the generated code, which refers to `::sm2_ros`.
extern crate self as sm2_ros;

pub mod cdr;
mod decode;
#[cfg(feature = "definitions")]
pub mod definitions;
mod encode;
mod error;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
#[cfg(feature = "messages")]
#[doc(hidden)]
pub mod message;
pub mod place;
mod types;
pub mod value;

pub use decode::decode;
pub use encode::encode;
pub use error::{DecodeError, EncodeError, Fault, FieldPath};
#[cfg(feature = "messages")]
#[doc(hidden)]
pub use sm2_node;
pub use types::{Action, Service, Type, TypeVisitor, Viewed, view};
#[cfg(feature = "messages")]
pub use types::{Client, Server};
pub use value::Value;

#[cfg(feature = "common-interfaces")]
include_types!();

/// Includes the types that `sm2-ros-build` has generated, as modules `package::msg::Type`.
#[macro_export]
macro_rules! include_types {
    () => {
        $crate::include_types!("sm2_ros_types.rs");
    };
    ($file:literal) => {
        include!(concat!(env!("OUT_DIR"), "/", $file));
    };
}

/// Implements nothing: the feature `messages` is off.
#[cfg(not(feature = "messages"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __message {
    ($type:ty) => {};
}
