//! The first difference of two schemas.

use proptest::{collection, prelude::*, sample::select};
use sm2_node::explain::{self, Difference};
use sm2_proto::schema::{Scalar, Schema};

/// The line between two definitions of ROS 2.
const SEPARATOR: &str =
    "================================================================================";
const IMU: &str = "plain:struct{stamp_ns:u64,acceleration:array[f64;0000000000000003],}";
const PATH: &str = "postcard:struct{frame:string,points:list[struct{0:f64,1:f64,}],\
    mode:enum{Idle:struct{},Follow:struct{type:u8,},Go:struct{0:struct{0:f64,1:f64,},},},\
    labels:map[string,option[u8]],}";
const STRING: &str =
    "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

fn parsed(text: &str) -> Schema {
    Schema::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn with(definition: &str) -> String {
    format!("cdr:{HASH}\n{definition}")
}

fn difference(here: &str, there: &str) -> Option<String> {
    let difference = explain::difference(&parsed(here), &parsed(there));
    difference.map(|it| it.to_string())
}

#[test]
fn the_first_difference_is_named_with_its_path() {
    let cases = [
        (
            "plain:u8",
            "postcard:u8",
            "message: encoded as plain here, encoded as postcard there",
        ),
        ("plain:u8", "plain:i8", "message: u8 here, i8 there"),
        (
            IMU,
            "plain:struct{stamp_ns:u64,acceleration:array[f64;0000000000000004],}",
            "acceleration: array of 3 f64 here, array of 4 f64 there",
        ),
        (
            "plain:struct{p:list[struct{x:f64,}],}",
            "plain:struct{p:list[struct{x:f32,}],}",
            "p[].x: f64 here, f32 there",
        ),
        (
            "plain:struct{a:struct{x:u8,},}",
            "plain:struct{a:struct{x:u8,y:u8,},}",
            "a: no more than 1 field here, field y there",
        ),
        (
            "plain:struct{a:u8,}",
            "plain:struct{b:u8,}",
            "message: field a here, field b there",
        ),
        (
            "plain:struct{}",
            "plain:struct{b:u8,}",
            "message: no fields here, field b there",
        ),
        (
            "json:enum{A:struct{},}",
            "json:enum{A:struct{v:u8,},}",
            "A: no fields here, field v there",
        ),
        (
            "json:enum{A:struct{},B:struct{},}",
            "json:enum{A:struct{},}",
            "message: variant B here, no more than 1 variant there",
        ),
        (
            "json:map[string,list[option[u8]]]",
            "json:map[string,list[option[string]]]",
            "[][]: u8 here, string there",
        ),
        (
            "plain:array[array[f64;0000000000000002];0000000000000003]",
            "plain:array[array[f32;0000000000000002];0000000000000003]",
            "[][]: f64 here, f32 there",
        ),
        (
            "json:map[string,u8]",
            "json:map[u8,u8]",
            "[key]: string here, u8 there",
        ),
        (
            "json:list[struct{a:u8,}]",
            "json:set[struct{a:u8,}]",
            "message: list of structure of 1 field here, set of structure of 1 field there",
        ),
    ];
    for (here, there, expected) in cases {
        assert_eq!(difference(here, there).as_deref(), Some(expected));
    }
    assert_eq!(difference(PATH, PATH), None);
}

#[test]
fn the_first_line_that_differs_is_named() {
    let other = STRING.replace("df66", "df67");
    let header = |ty: &str| {
        let text = format!("{SEPARATOR}\nMSG: std_msgs/Header\n{ty} frame_id\n");
        with(&format!("std_msgs/Header header\n{text}"))
    };
    let cases = [
        (
            with("uint8 x\n"),
            with("int8 x\n"),
            "message: `uint8 x` here, `int8 x` there",
        ),
        (
            with("uint8 x\n"),
            with("uint8 x\nuint8 y\n"),
            "message: no more lines here, `uint8 y` there",
        ),
        (
            header("string"),
            header("wstring"),
            "std_msgs/Header: `string frame_id` here, `wstring frame_id` there",
        ),
        (
            STRING.into(),
            "json:struct{data:string,}".into(),
            "message: encoded as cdr here, encoded as json there",
        ),
        (
            STRING.into(),
            other.clone(),
            &format!("message: {HASH} here, {} there", &other[4..75]),
        ),
    ];
    for (here, there, expected) in cases {
        assert_eq!(difference(&here, &there).as_deref(), Some(expected));
    }
    assert_eq!(difference(STRING, STRING), None);
}

/// The text of a structure.
fn fields(ty: impl Strategy<Value = String>) -> impl Strategy<Value = String> {
    collection::btree_map("[a-zA-Z0-9_ü界-]{1,6}", ty, 0..4).prop_map(|fields| {
        let fields = fields.iter().map(|(name, ty)| format!("{name}:{ty},"));
        format!("struct{{{}}}", fields.collect::<String>())
    })
}

fn types() -> impl Strategy<Value = String> {
    let scalars = select(Scalar::ALL).prop_map(|it| it.name().to_owned());
    let leaf = prop_oneof![scalars, Just("string".to_owned())];
    leaf.prop_recursive(6, 60, 4, |inner| {
        let one = || inner.clone();
        let variants = collection::btree_map("[a-zA-Z]{1,6}", fields(one()), 0..4);
        prop_oneof![
            fields(one()),
            variants.prop_map(|it| {
                let variants = it.iter().map(|(name, fields)| format!("{name}:{fields},"));
                format!("enum{{{}}}", variants.collect::<String>())
            }),
            (one(), any::<u64>()).prop_map(|(ty, len)| format!("array[{ty};{len:016x}]")),
            (select(vec!["list", "set", "option"]), one())
                .prop_map(|(kind, ty)| format!("{kind}[{ty}]")),
            (one(), one()).prop_map(|(key, value)| format!("map[{key},{value}]")),
        ]
    })
}

fn schemas() -> impl Strategy<Value = Schema> {
    let encodings = select(vec!["plain", "postcard", "json", "other-1"]);
    let trees = (encodings, types()).prop_map(|(encoding, ty)| format!("{encoding}:{ty}"));
    let lines = prop_oneof![Just(SEPARATOR.into()), "[ -~\u{a0}-\u{ffff}]{1,12}"];
    let definitions = ("[0-9a-f]{64}", collection::vec(lines, 0..6));
    let definitions = definitions.prop_map(|(hash, lines)| {
        let lines = lines.iter().map(|line| format!("{line}\n"));
        format!("cdr:RIHS01_{hash}\n{}", lines.collect::<String>())
    });
    let texts = prop_oneof![4 => trees, 1 => definitions];
    texts.prop_map(|text| parsed(&text))
}

proptest! {
    #[test]
    fn schemas_that_differ_have_a_difference(here in schemas(), there in schemas()) {
        let found = explain::difference(&here, &there);
        prop_assert_eq!(found.is_some(), here != there);
        prop_assert_eq!(explain::difference(&here, &here), None);
        if let Some(Difference { path, here: one, there: other }) = found {
            prop_assert_ne!(&one, &other, "{}", path);
        }
    }
}
