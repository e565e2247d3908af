//! Hashes of types, and texts of definitions that are wrong.

use std::path::Path;

use sm2_ros_idl::{Kind, Reason, Set, SetError, TypeName};

fn set() -> Set {
    let mut set = Set::default();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../definitions");
    set.add_folder(&folder).unwrap();
    set
}

fn name(text: &str) -> TypeName {
    text.parse().unwrap()
}

fn hash(set: &Set, of: &str) -> String {
    set.hash(&name(of)).unwrap().to_string()
}

/// These hashes are from ROS 2 Jazzy. `sm2-ros/oracle` compares all types with another implementation.
#[test]
fn hashes_are_those_of_ros_2() {
    let mut set = set();
    let text = "int64 a\nint64 b\n---\nint64 sum\n";
    set.add(&name("example_interfaces/srv/AddTwoInts"), text)
        .unwrap();
    for (of, expected) in [
        (
            "std_msgs/msg/String",
            "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        ),
        (
            "std_msgs/msg/Char",
            "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
        ),
        // A message without fields has one in the hash.
        (
            "std_msgs/msg/Empty",
            "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
        ),
        (
            "std_msgs/msg/Bool",
            "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
        ),
        (
            "sensor_msgs/msg/Image",
            "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        ),
        // The hash of a service covers its event, and so `ServiceEventInfo`.
        (
            "example_interfaces/srv/AddTwoInts",
            "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
        ),
    ] {
        assert_eq!(hash(&set, of), expected, "{of}");
    }
}

/// Comments, constants and default values are not part of a hash; names, types and limits are.
#[test]
fn only_fields_change_a_hash() {
    let of = name("p/msg/T");
    let hash = |text: &str| {
        let mut set = Set::default();
        set.add(&of, text).unwrap();
        set.hash(&of).unwrap()
    };
    let plain = hash("int32 a\nstring b\n");
    assert_eq!(
        hash("# c\nint32 X=1\nint32 a 7 # d\n\nstring b \"#\"\n"),
        plain
    );
    for other in [
        "int32 c\nstring b",
        "uint32 a\nstring b",
        "string b\nint32 a",
        "int32 a\nstring<=5 b",
        "int32[] a\nstring b",
    ] {
        assert_ne!(hash(other), plain, "{other}");
    }
}

#[test]
fn the_text_of_each_type_has_its_hash() {
    let set = set();
    let mut longest = 0;
    for message in set.types() {
        let text = set.text(&message.name).unwrap();
        let again = Set::parse(&message.name, &text).unwrap();
        assert_eq!(set.hash(&message.name), again.hash(&message.name));
        assert_eq!(again.text(&message.name).as_ref(), Ok(&text));
        longest = longest.max(text.len());
    }
    assert!(
        longest < 16_384,
        "{longest} bytes: a schema text has 32,768 at most"
    );
}

#[test]
fn wrong_lines_have_a_reason() {
    let of = name("p/msg/T");
    let reason = |text: &str| {
        let error = Set::default().add(&of, text).unwrap_err();
        (error.line, error.reason)
    };
    assert_eq!(reason("int32"), (1, Reason::Name));
    assert_eq!(reason("\nint32 1a"), (2, Reason::IllegalName("1a".into())));
    assert_eq!(
        reason("int32 a\nint32 a"),
        (2, Reason::NameTwice("a".into()))
    );
    assert_eq!(reason("int32[0] a"), (1, Reason::Limit("0".into())));
    assert_eq!(reason("string<=x a"), (1, Reason::Limit("x".into())));
    assert_eq!(reason("int32 A="), (1, Reason::ConstantValue));
    assert_eq!(reason("p/Q A=1"), (1, Reason::ConstantType));
    assert!(matches!(reason("a-b c"), (1, Reason::Type(_))));
    let (expected, found) = (0, 1);
    assert_eq!(
        reason("int32 a\n---\n"),
        (2, Reason::Sections { expected, found })
    );
    let error = Set::parse(&of, "Q q\n===\nint32 a\n").unwrap_err();
    assert_eq!((error.line, error.reason), (3, Reason::Header));
}

/// The names of the parts of a service or action are names, too.
#[test]
fn a_name_has_room_for_its_suffixes() {
    let longest = |kind, suffix: &str| {
        let own = "T".repeat(120 - suffix.len());
        TypeName::new("p", kind, &own).unwrap()
    };
    for (kind, suffix, text) in [
        (Kind::Srv, "_Response", "---\n"),
        (Kind::Action, "_GetResult_Response", "---\n---\n"),
    ] {
        Set::default().add(&longest(kind, suffix), text).unwrap();
        let suffix = &suffix[..suffix.len() - 1];
        let error = Set::default().add(&longest(kind, suffix), text);
        assert!(matches!(error.unwrap_err().reason, Reason::Type(_)));
    }
}

#[test]
fn types_that_are_missing_or_endless_are_refused() {
    let mut set = Set::default();
    let (a, b) = (name("p/msg/A"), name("p/msg/B"));
    assert_eq!(set.hash(&a), Err(SetError::Unknown(a.clone())));
    set.add(&a, "B b").unwrap();
    let missing = SetError::Missing {
        user: a.clone(),
        missing: b.clone(),
    };
    assert_eq!(set.hash(&a), Err(missing));
    set.add(&b, "A[] a").unwrap();
    assert_eq!(set.hash(&a), Err(SetError::Cycle(a)));
    // A chain of types has a limit, too.
    for at in 0..100 {
        let this = TypeName::new("p", Kind::Msg, &format!("T{at}")).unwrap();
        set.add(&this, &format!("T{} next", at + 1)).unwrap();
    }
    set.add(&name("p/msg/T100"), "int8 a").unwrap();
    // From T37 to T100, 64 types are inside each other.
    set.hash(&name("p/msg/T37")).unwrap();
    for first in ["p/msg/T36", "p/msg/T0"].map(name) {
        assert_eq!(set.hash(&first), Err(SetError::TooDeep(first)));
    }
}

#[test]
fn a_schema_text_has_the_hash_and_the_definition() {
    let text = set().schema_text(&name("std_msgs/msg/String")).unwrap();
    let expected = "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
    assert_eq!(text, expected);
}
