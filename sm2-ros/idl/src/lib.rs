//! ROS 2 interface definitions: `.msg`, `.srv` and `.action` texts, and the hashes of the types that they define.
//!
//! [`Set`] holds types and the types that they refer to. [`Set::add`] reads one definition;
//! [`Set::add_folder`] reads the definitions of a package. [`Set::hash`] computes the RIHS01 hash of a type,
//! which is how ROS 2 compares types, and [`Set::text`] writes a type with all types that it refers to in the form
//! that MCAP calls `ros2msg`; [`Set::parse`] reads that form.
//!
//! Definitions can come from hostile peers. Reading them does not panic, does not recurse, and uses memory in
//! proportion to the length of the text.
#![forbid(unsafe_code)]

mod comment;
mod error;
mod folder;
mod hash;
mod interface;
mod name;
mod parse;
mod set;
mod text;
mod ty;

pub use error::{DefinitionError, FolderError, Reason, SetError};
pub use hash::TypeHash;
pub use name::{Kind, NameError, TypeName};
pub use set::Set;
pub use ty::{Base, Constant, Field, FieldType, Message, Primitive, Shape};
