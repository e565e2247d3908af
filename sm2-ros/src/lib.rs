//! Messages of ROS 2: their bytes in CDR, read and written by the definitions of their types.
//!
//! [`decode`] turns the bytes of a message into a [`Value`] with the names of its fields, and [`encode`] turns
//! JSON into bytes. Both need only the definition of the type, as [`sm2_ros_idl::Set`] holds it, so tools work
//! with types that they were not built with.
//!
//! CDR is the encoding that ROS 2 uses on the wire and in bags: XCDR version 1. A message begins with four
//! bytes, of which the second says the byte order (0 big-endian, 1 little-endian). Each number is aligned to
//! its size, counted from the fifth byte. A text and a sequence begin with their length in 32 bits.
//!
//! Bytes can come from hostile peers. Decoding does not panic, and every length is compared with the bytes that
//! remain before memory is allocated for it.
#![forbid(unsafe_code)]

mod decode;
mod encode;
mod error;
mod reader;
mod value;
mod writer;

pub use decode::decode;
pub use encode::encode;
pub use error::{DecodeError, EncodeError, Fault};
pub use value::Value;
