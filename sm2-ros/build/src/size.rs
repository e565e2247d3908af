//! The memory of a generated type, which programs put on the stack.

use std::collections::BTreeMap;

use sm2_ros_idl::{Base, Field, Set, SetError, Shape, TypeName};

/// The largest type, in bytes. A thread has 2 MiB of stack by default, and a message that is decoded is copied there.
pub(crate) const SIZE_MAX_BYTES: usize = 128 << 10;
/// The size of a `String` and of a `Vec`, in bytes.
const OWNED_BYTES: usize = 24;

/// The size of a type, in bytes, without padding.
pub(crate) fn size_bytes(name: &TypeName, set: &Set) -> Result<usize, SetError> {
    let mut sizes = BTreeMap::new();
    let mut size = 0;
    // A type comes after those of its fields.
    for message in set.closure(name)? {
        let of = |field: &Field| {
            let one = match &field.ty.base {
                Base::Primitive(primitive) => primitive.size_bytes(),
                Base::String { .. } | Base::WString { .. } => OWNED_BYTES,
                Base::Message(part) => sizes.get(part).copied().unwrap_or(0),
            };
            match field.ty.shape {
                Shape::One => one,
                Shape::Array(len) => one.saturating_mul(len as usize),
                Shape::Sequence(_) => OWNED_BYTES,
            }
        };
        size = message.fields.iter().map(of).fold(0, usize::saturating_add);
        sizes.insert(&message.name, size);
    }
    Ok(size)
}
