//! Built-in message types, whose names alone determine their hashes and schemas.

use sm2_node::Message;
use sm2_proto::{Name, TypeId};

/// A message type, and its schema text if it has one (`bytes` has none).
pub(crate) struct BuiltIn {
    pub(crate) data: TypeId,
    pub(crate) schema: Option<String>,
}

/// The type of this name, as `sm2_node` declares it.
pub(crate) fn named(name: &Name) -> Option<BuiltIn> {
    macro_rules! any_of {
        ($($type:ty),*) => {
            [$((<$type as Message>::NAME, built_in::<$type> as fn() -> BuiltIn)),*]
        };
    }
    let all = any_of!(
        str,
        u8,
        u16,
        u32,
        u64,
        u128,
        i8,
        i16,
        i32,
        i64,
        i128,
        f32,
        f64,
        (),
        [u8],
        [u16],
        [u32],
        [u64],
        [u128],
        [i8],
        [i16],
        [i32],
        [i64],
        [i128],
        [f32],
        [f64]
    );
    let (_, make) = all.into_iter().find(|(known, _)| *known == name.as_str())?;
    Some(make())
}

fn built_in<M: Message + ?Sized>() -> BuiltIn {
    BuiltIn {
        data: M::type_id(),
        schema: M::schema(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stands_for_the_type_of_the_library() {
        let find = |name| named(&Name::new(name).unwrap());
        let text = find("text").unwrap();
        assert_eq!(text.data, <str as Message>::type_id());
        assert_eq!(text.schema.as_deref(), Some("plain:string"));
        let list = find("f32-list").unwrap();
        assert_eq!(list.data, <[f32] as Message>::type_id());
        let bytes = find("bytes").unwrap();
        assert_eq!((bytes.data.hash, bytes.schema), (0, None));
        assert!(find("nav/Goal").is_none());
    }
}
