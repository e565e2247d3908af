//! The Rust types of all common interfaces against the codec that works by definitions.

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use serde_json::json;
use sm2_ros::cdr::{from_slice, to_vec};
use sm2_ros::{EncodeError, TypeVisitor, Viewed, decode, encode, for_each_type, view};
use sm2_ros_idl::{Base, FieldType, Primitive, Set, Shape, TypeName};

fn set() -> Set {
    let mut set = Set::default();
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/definitions");
    set.add_folder(folder.as_ref()).unwrap();
    set
}

/// How many messages of each type are tried.
const MESSAGES: usize = if cfg!(feature = "slow") { 8 } else { 2 };

/// A random message as JSON: 64 bits of `seed` choose each value.
fn message(set: &Set, name: &TypeName, next: &mut dyn FnMut() -> u64) -> serde_json::Value {
    let fields = &set.get(name).unwrap().fields;
    let fields = fields.iter().map(|field| {
        let value = field_value(set, &field.ty, next);
        (String::from(&*field.name), value)
    });
    serde_json::Value::Object(fields.collect())
}

fn field_value(set: &Set, ty: &FieldType, next: &mut dyn FnMut() -> u64) -> serde_json::Value {
    let len = match ty.shape {
        Shape::One => return value(set, &ty.base, next),
        Shape::Array(len) => len,
        Shape::Sequence(max) => (next() % 4) as u32 % (max.unwrap_or(4).saturating_add(1)),
    };
    (0..len).map(|_| value(set, &ty.base, next)).collect()
}

fn value(set: &Set, base: &Base, next: &mut dyn FnMut() -> u64) -> serde_json::Value {
    let number = next();
    let signed = number as i64;
    match base {
        Base::Primitive(primitive) => match primitive {
            Primitive::Bool => json!(number.is_multiple_of(2)),
            Primitive::Byte | Primitive::Char | Primitive::Uint8 => json!(number as u8),
            Primitive::Int8 => json!(signed as i8),
            Primitive::Uint16 => json!(number as u16),
            Primitive::Int16 => json!(signed as i16),
            Primitive::Uint32 => json!(number as u32),
            Primitive::Int32 => json!(signed as i32),
            Primitive::Uint64 => json!(number),
            Primitive::Int64 => json!(signed),
            Primitive::Float32 => json!(f64::from(signed as i16) / 8.0),
            Primitive::Float64 => json!(signed as f64 / 1024.0),
        },
        Base::String { .. } | Base::WString { .. } => {
            json!(["", "a", "ä€", "x y z"][(number % 4) as usize])
        }
        Base::Message(name) => message(set, name, next),
    }
}

struct RoundTrips<'a> {
    set: &'a Set,
    types: usize,
    state: u64,
}

impl TypeVisitor for RoundTrips<'_> {
    fn visit<T: Viewed>(&mut self) {
        let name: TypeName = T::TYPE_NAME.parse().unwrap();
        assert_eq!(self.set.hash(&name).unwrap().0, T::RIHS01, "{name}");
        assert_eq!(self.set.schema_text(&name).unwrap(), T::SCHEMA, "{name}");
        let default = encode(self.set, &name, &json!({})).unwrap();
        assert_eq!(to_vec(&T::default()).unwrap(), default, "{name}");
        for _ in 0..MESSAGES {
            let state = &mut self.state;
            let value = message(self.set, &name, &mut || {
                // Numerical Recipes' linear congruential generator; its upper half is random enough.
                *state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                *state ^ (*state >> 32)
            });
            let bytes = encode(self.set, &name, &value).unwrap();
            let typed: T = from_slice(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(to_vec(&typed).unwrap(), bytes, "{name}: {value}");
            // The view has the same names and values.
            let read = view::<T>(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(format!("{read:?}"), format!("{typed:?}"), "{name}");
            // A cut message is an error, or else differs only in the last bytes that may be filled.
            for len in 0..bytes.len() {
                let cut = from_slice::<T>(&bytes[..len]);
                assert!(cut.is_err(), "{name}: {len} of {} bytes", bytes.len());
                assert_eq!(view::<T>(&bytes[..len]).err(), cut.err(), "{name}: {len}");
            }
        }
        self.types += 1;
    }
}

#[test]
fn typed_bytes_are_those_of_the_definitions() {
    let (set, mut visitor) = (
        set(),
        RoundTrips {
            set: &set(),
            types: 0,
            state: 7,
        },
    );
    for_each_type(&mut visitor);
    // Services and actions themselves have no bytes, and their parts are in the set.
    let is_message = |name: &TypeName| {
        let parts = ["_Request", "_SendGoal"].map(|it| format!("{name}{it}").parse());
        let mut parts = parts.into_iter().flatten();
        parts.all(|it: TypeName| set.get(&it).is_err())
    };
    let messages = set.types().filter(|it| is_message(&it.name)).count();
    assert_eq!(visitor.types, messages);
}

struct Hostile<'a> {
    set: &'a Set,
    bytes: &'a [u8],
}

impl TypeVisitor for Hostile<'_> {
    /// Both codecs and the view agree on whether the bytes are a message.
    fn visit<T: Viewed>(&mut self) {
        let name: TypeName = T::TYPE_NAME.parse().unwrap();
        let typed = from_slice::<T>(self.bytes);
        let dynamic = decode(self.set, &name, self.bytes, 0);
        assert_eq!(
            typed.is_ok(),
            dynamic.is_ok(),
            "{name}: {typed:?}, {dynamic:?}"
        );
        let read = view::<T>(self.bytes).map(|it| format!("{it:?}"));
        assert_eq!(read, typed.map(|it| format!("{it:?}")), "{name}");
    }
}

#[test]
fn hostile_bytes_are_errors() {
    let set = set();
    let config = Config {
        cases: 32,
        failure_persistence: None,
        ..Config::default()
    };
    let byte = prop_oneof![4 => Just(0_u8), 1 => Just(1), 1 => any::<u8>()];
    let bytes = prop::collection::vec(byte, 0..200).prop_map(|mut bytes| {
        bytes.splice(0..0, [0, 1, 0, 0]);
        bytes
    });
    let result = TestRunner::new(config).run(&bytes, |bytes| {
        for_each_type(&mut Hostile {
            set: &set,
            bytes: &bytes,
        });
        Ok(())
    });
    result.unwrap();
}

#[test]
fn limits_are_checked_in_both_directions() {
    let solid = sm2_ros::shape_msgs::msg::SolidPrimitive {
        dimensions: vec![1.0; 4],
        ..Default::default()
    };
    let error = to_vec(&solid).unwrap_err();
    let EncodeError::Limit {
        path,
        len: 4,
        max: 3,
    } = &error
    else {
        panic!("{error}");
    };
    assert_eq!(path.to_string(), "dimensions");
}
