//! The derive macros, and the hashes that other programs and ports must reproduce.

use std::collections::{BTreeMap, HashMap};

use serde::{Deserialize, Serialize};
use sm2_node::zerocopy::little_endian::U32;
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{Message, Payload, PayloadError, Schema};

mod one {
    use super::*;

    #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Debug, PartialEq)]
    #[message(name = "sensor/Imu")]
    #[repr(C)]
    pub(crate) struct Imu {
        pub(crate) stamp_ns: u64,
        pub(crate) acceleration: [f64; 3],
    }

    #[derive(Message, Serialize, Deserialize, Debug, PartialEq, Clone)]
    #[message(name = "nav/Path", encoding = "postcard")]
    pub(crate) struct Path {
        pub(crate) frame: String,
        pub(crate) points: Vec<Point>,
        pub(crate) mode: Mode,
        pub(crate) labels: BTreeMap<String, Option<u8>>,
    }

    #[derive(Schema, Serialize, Deserialize, Debug, PartialEq, Clone)]
    pub(crate) struct Point(pub(crate) f64, pub(crate) f64);

    #[derive(Schema, Serialize, Deserialize, Debug, PartialEq, Clone)]
    pub(crate) enum Mode {
        Idle,
        Follow { r#type: u8 },
        Go(Point),
    }
}

/// The same structures in another module, with other Rust names.
mod two {
    use super::*;

    #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[message(name = "sensor/Imu")]
    #[repr(C)]
    pub(crate) struct Inertial {
        stamp_ns: u64,
        acceleration: [f64; 3],
    }

    #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[message(name = "sensor/Imu")]
    #[repr(C)]
    pub(crate) struct Renamed {
        stamp_us: u64,
        acceleration: [f64; 3],
    }

    #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[message(name = "sensor/Imu")]
    #[repr(C)]
    pub(crate) struct Retyped {
        stamp_ns: i64,
        acceleration: [f64; 3],
    }

    #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[message(name = "sensor/Imu")]
    #[repr(C)]
    pub(crate) struct Reordered {
        acceleration: [f64; 3],
        stamp_ns: u64,
    }

    #[derive(Message, Serialize, Deserialize)]
    #[message(name = "sensor/Imu", encoding = "postcard")]
    pub(crate) struct Encoded {
        stamp_ns: u64,
        acceleration: [f64; 3],
    }
}

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Debug)]
#[message(name = "sensor/Image", encoding = "plain")]
#[repr(C)]
struct Image {
    width: U32,
    height: U32,
    pixels: [u8],
}

/// The same message with ordinary numbers, which leave no padding when packed.
#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Image")]
#[repr(C, packed)]
struct Packed {
    width: u32,
    height: u32,
    pixels: [u8],
}

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Stamped")]
#[repr(C, packed)]
struct Stamped<T> {
    stamp_ns: u64,
    data: T,
}

#[derive(Message, Serialize, Deserialize)]
#[message(name = "tools/Pair", encoding = "postcard")]
struct Pair<A, B> {
    first: A,
    second: Vec<B>,
}

fn hash<T: Message + ?Sized>() -> u64 {
    T::HASH
}

//= SM2-NAM-003 test
#[test]
fn hashes_are_these_numbers_for_ever() {
    let golden = [
        (hash::<[u8]>(), 0),
        (<f64 as Schema>::HASH, 0xdd74_4c18_ff7e_a1ab),
        (hash::<f64>(), 0x4500_6ed6_bb55_2769),
        (hash::<[f32]>(), 0x38b4_5b57_8157_b044),
        (hash::<()>(), 0x9945_91ea_8828_e7a7),
        (hash::<str>(), 0xeb80_3ec8_3498_ec4b),
        (hash::<one::Imu>(), 0x01d4_8e4b_179e_db4c),
        (hash::<Image>(), 0xbdc5_2005_1bf8_0883),
        (hash::<one::Path>(), 0x5f2d_bc11_1d07_b51f),
        (hash::<Pair<u32, (bool, char)>>(), 0xc5fe_f622_5252_7c1d),
        (
            <HashMap<i8, Box<str>> as Schema>::HASH,
            0x81bc_7344_db2a_9c89,
        ),
    ];
    for (index, (found, expected)) in golden.into_iter().enumerate() {
        assert_eq!(found, expected, "{index}: {found:#018x}");
    }
}

/// Computes a hash by hand, by the rule in the module's documentation.
#[test]
fn a_hash_is_that_of_the_text_in_the_documentation() {
    fn fnv(text: &str) -> u64 {
        (text.bytes()).fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
        })
    }
    let array = format!("array[{:016x};{:016x}]", fnv("f64"), 3);
    let imu = format!(
        "struct{{stamp_ns:{:016x},acceleration:{:016x},}}",
        fnv("u64"),
        fnv(&array)
    );
    assert_eq!(<one::Imu as Schema>::HASH, fnv(&imu));
    assert_eq!(
        hash::<one::Imu>(),
        fnv(&format!("plain:{:016x}", fnv(&imu)))
    );
    let follow = fnv(&format!("struct{{type:{:016x},}}", fnv("u8")));
    let point = fnv(&format!("struct{{0:{0:016x},1:{0:016x},}}", fnv("f64")));
    let go = fnv(&format!("struct{{0:{point:016x},}}"));
    let idle = fnv("struct{}");
    let mode = format!("enum{{Idle:{idle:016x},Follow:{follow:016x},Go:{go:016x},}}");
    assert_eq!(<one::Mode as Schema>::HASH, fnv(&mode));
}

//= SM2-NAM-003 test
#[test]
fn the_hash_follows_the_structure_and_nothing_else() {
    let imu = one::Imu::type_id();
    assert_eq!(imu, two::Inertial::type_id());
    assert_eq!(Image::type_id(), Packed::type_id());
    let others = [
        two::Renamed::type_id(),
        two::Retyped::type_id(),
        two::Reordered::type_id(),
        two::Encoded::type_id(),
    ];
    for other in others {
        assert_eq!(other.name, imu.name);
        assert_ne!(other.hash, imu.hash, "{other}");
    }
    assert_ne!(hash::<Stamped<u64>>(), hash::<Stamped<i64>>());
    assert_ne!(hash::<Pair<u8, u8>>(), hash::<Pair<u8, u16>>());
}

#[test]
fn slices_are_named_after_their_elements() {
    assert_eq!(<[u8]>::type_id().name.as_str(), "bytes");
    assert_eq!(<[u8]>::type_id().hash, 0);
    assert_eq!(<[f32]>::type_id().name.as_str(), "f32-list");
    assert_eq!(<[one::Imu]>::type_id().name.as_str(), "sensor/Imu-list");
    assert_eq!(str::type_id(), String::type_id());
}

fn seen<T: Message + ?Sized>(value: &T) -> T::View {
    let bytes = value.bytes().unwrap().into_owned();
    T::view(Payload::from(bytes)).unwrap()
}

#[test]
fn every_kind_of_message_comes_back_as_it_was() {
    let imu = one::Imu {
        stamp_ns: 7,
        acceleration: [0.0, -9.81, 1e300],
    };
    assert_eq!(*seen(&imu), imu);
    assert_eq!(*seen(&[1_u64, 2, 3][..]), [1, 2, 3]);
    assert_eq!(*seen(&b"raw"[..]), *b"raw");
    assert_eq!(*seen(&-0.5_f32), -0.5);
    assert_eq!(&*seen("grüße"), "grüße");
    assert_eq!(*seen(&"text".to_owned()), "text");
    let path = one::Path {
        frame: "map".to_owned(),
        points: vec![one::Point(1.0, 2.0)],
        mode: one::Mode::Go(one::Point(3.0, 4.0)),
        labels: BTreeMap::from([("a".to_owned(), Some(1)), ("b".to_owned(), None)]),
    };
    assert_eq!(*seen(&path), path);
    let mut bytes = vec![2, 0, 0, 0, 1, 0, 0, 0];
    bytes.extend([10, 20]);
    let image = Image::view(Payload::from(bytes)).unwrap();
    assert_eq!((image.width.get(), image.height.get()), (2, 1));
    assert_eq!(image.pixels, [10, 20]);
}

#[test]
fn memory_that_is_not_aligned_is_copied_to_where_it_is() {
    // Wherever the allocator places the buffer, one of these offsets is misaligned for an Imu.
    for offset in 0..8 {
        let bytes = bytes::Bytes::from(vec![1; 32 + offset]).slice(offset..);
        let imu = one::Imu::view(Payload::from(bytes)).unwrap();
        assert_eq!(imu.stamp_ns, 0x0101_0101_0101_0101);
    }
}

#[test]
fn bytes_that_are_no_message_are_an_error_that_names_the_type() {
    let length = one::Imu::view(Payload::from(vec![0; 31])).unwrap_err();
    assert_eq!(
        length,
        PayloadError::Length {
            type_name: "sensor/Imu",
            len: 31
        }
    );
    assert!(<[u32]>::view(Payload::from(vec![0; 7])).is_err());
    assert!(Image::view(Payload::from(vec![0; 7])).is_err());
    let text = str::view(Payload::from(vec![0xff]))
        .unwrap_err()
        .to_string();
    assert!(text.contains("text") && text.contains("1 bytes"), "{text}");
    let cut = one::Path::view(Payload::from(vec![3, b'm'])).unwrap_err();
    assert!(cut.to_string().contains("nav/Path"), "{cut}");
    let mut long = Pair::<u8, u8>::bytes(&Pair {
        first: 1,
        second: vec![2],
    })
    .unwrap()
    .into_owned();
    long.push(0);
    let long = Pair::<u8, u8>::view(Payload::from(long)).err().unwrap();
    assert!(long.to_string().contains("1 byte too many"), "{long}");
}
