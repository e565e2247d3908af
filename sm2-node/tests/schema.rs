//! Schema texts: each gives the hash of its type, and tools can parse it.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sm2_node::zerocopy::little_endian::{F64, U32};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{EncodeError, Message, Payload, PayloadError, Schema, schema};
use sm2_proto::limits::{SCHEMA_DEPTH_MAX, SCHEMA_TEXT_MAX};

/// A message that contains a `T`.
#[derive(Message, Serialize, Deserialize)]
#[message(name = "tests/Any", encoding = "postcard")]
struct Any<T>(T);

/// Returns the type's text, and checks that the type's hash follows from it.
fn text<M: Message + ?Sized>() -> String {
    let text = M::schema().unwrap_or_else(|| panic!("{} has no text", M::NAME));
    let schema = sm2_proto::schema::Schema::parse(&text);
    let schema = schema.unwrap_or_else(|error| panic!("{text}: {error}"));
    assert_eq!(schema.hash(), M::HASH, "{text}");
    assert_eq!(schema.to_string(), text);
    text
}

/// Returns the text of a part of type `T`.
fn part<T: Schema + Serialize + for<'a> Deserialize<'a> + Send + Sync + 'static>() -> String {
    let text = text::<Any<T>>();
    let part = text.strip_prefix("postcard:struct{0:").unwrap();
    part.strip_suffix(",}").unwrap().to_owned()
}

//= SM2-TYP-001 test
#[test]
fn the_hash_of_every_built_in_type_follows_from_its_text() {
    macro_rules! scalars {
        ($($scalar:ident)*) => { $(
            assert_eq!(part::<$scalar>(), stringify!($scalar));
        )* };
    }
    scalars! { u8 u16 u32 u64 u128 i8 i16 i32 i64 i128 f32 f64 bool char }
    macro_rules! numbers {
        ($($number:ident)*) => { $(
            assert_eq!(text::<$number>(), concat!("plain:", stringify!($number)));
assert_eq!(text::<[$number]>(), concat!("plain:list[", stringify!($number), "]"));
        )* };
    }
    numbers! { u16 u32 u64 u128 i8 i16 i32 i64 i128 f32 f64 }
    assert_eq!(text::<()>(), "plain:struct{}");
    assert_eq!(text::<str>(), "plain:string");
    assert_eq!(text::<String>(), "plain:string");
    assert_eq!(text::<[f64]>(), "plain:list[f64]");
    let parts = [
        (part::<String>(), "string"),
        (part::<Box<str>>(), "string"),
        (part::<[u8; 17]>(), "array[u8;0000000000000011]"),
        (part::<Vec<u8>>(), "list[u8]"),
        (part::<VecDeque<u8>>(), "list[u8]"),
        (part::<BTreeSet<u8>>(), "set[u8]"),
        (part::<HashSet<u8>>(), "set[u8]"),
        (part::<BTreeMap<u8, bool>>(), "map[u8,bool]"),
        (part::<HashMap<u8, bool>>(), "map[u8,bool]"),
        (part::<Option<Option<char>>>(), "option[option[char]]"),
        (part::<(u8,)>(), "struct{0:u8,}"),
        (
            part::<(u8, i8, u16, i16, u32, i32)>(),
            "struct{0:u8,1:i8,2:u16,3:i16,4:u32,5:i32,}",
        ),
        (part::<Duration>(), "struct{secs:u64,nanos:u32,}"),
    ];
    for (found, expected) in parts {
        assert_eq!(found, expected);
    }
}

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Imu")]
#[repr(C)]
struct Imu {
    stamp_ns: u64,
    acceleration: [f64; 3],
}

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Scan")]
#[repr(C)]
struct Scan {
    count: U32,
    points: [[F64; 2]],
}

#[derive(Message, Serialize, Deserialize)]
#[message(name = "nav/Path", encoding = "postcard")]
struct Path {
    frame: String,
    points: Vec<(f64, f64)>,
    r#type: Mode,
}

#[derive(Schema, Serialize, Deserialize)]
enum Mode {
    Idle,
    Follow { speed: f32 },
    Go(u8, Metres),
}

#[derive(Schema, Serialize, Deserialize)]
struct Metres(f64);

//= SM2-TYP-001 test
#[test]
fn a_derived_type_has_the_text_of_its_structure() {
    assert_eq!(
        text::<Imu>(),
        "plain:struct{stamp_ns:u64,acceleration:array[f64;0000000000000003],}"
    );
    assert_eq!(
        text::<[Imu]>(),
        "plain:list[struct{stamp_ns:u64,acceleration:array[f64;0000000000000003],}]"
    );
    assert_eq!(
        text::<Scan>(),
        "plain:struct{count:u32,points:list[array[f64;0000000000000002]],}"
    );
    assert_eq!(
        text::<Path>(),
        "postcard:struct{frame:string,points:list[struct{0:f64,1:f64,}],type:enum{\
         Idle:struct{},Follow:struct{speed:f32,},Go:struct{0:u8,1:struct{0:f64,},},},}"
    );
    assert_eq!(text::<Any<Metres>>(), "postcard:struct{0:struct{0:f64,},}");
}

/// A recursive type, so its hash was chosen by hand.
#[derive(Serialize, Deserialize)]
struct Tree {
    children: Vec<Tree>,
}

impl Schema for Tree {
    const HASH: u64 = schema::text("tree, version 1");
}

macro_rules! nested {
    ($outer:ident of $inner:ty) => {
        #[derive(Schema, Serialize, Deserialize)]
        struct $outer(
            $inner,
            $inner,
            $inner,
            $inner,
            $inner,
            $inner,
            $inner,
            $inner,
        );
    };
}

nested!(N1 of u8);
nested!(N2 of N1);
nested!(N3 of N2);
nested!(N4 of N3);
nested!(N5 of N4);
nested!(N6 of N5);
nested!(N7 of N6);
nested!(N8 of N7);

/// As deep as a text may be.
#[derive(Serialize, Deserialize)]
struct Deep;

impl Schema for Deep {
    const HASH: u64 = {
        let (mut hash, mut depth) = (<u8 as Schema>::HASH, 0);
        while depth < SCHEMA_DEPTH_MAX {
            (hash, depth) = (schema::list(hash), depth + 1);
        }
        hash
    };

    fn describe(text: &mut String) -> bool {
        let (open, close) = (
            "list[".repeat(SCHEMA_DEPTH_MAX),
            "]".repeat(SCHEMA_DEPTH_MAX),
        );
        text.push_str(&format!("{open}u8{close}"));
        true
    }
}

/// A type whose hash does not follow from its text.
#[derive(Serialize, Deserialize)]
struct Misnamed;

impl Schema for Misnamed {
    const HASH: u64 = <u8 as Schema>::HASH;

    fn describe(text: &mut String) -> bool {
        u16::describe(text)
    }
}

#[test]
fn what_has_no_text_says_so_soon() {
    assert_eq!(<[u8]>::schema(), None);
    assert_eq!(Any::<Tree>::schema(), None);
    assert_eq!(Any::<Vec<Option<Tree>>>::schema(), None);
    // Its whole text would take a hundred megabytes.
    assert_eq!(Any::<N8>::schema(), None);
    let mut text = String::new();
    assert!(!N8::describe(&mut text) && text.len() < 2 * SCHEMA_TEXT_MAX);
    assert!(N2::describe(&mut String::new()));
    // Inside a structure it is nested too deeply.
    assert_eq!(Any::<Deep>::schema(), None);
    assert_eq!(Any::<Misnamed>::schema(), None);
}

/// A type with its own encoding.
#[derive(Schema, Debug, PartialEq)]
struct Celsius(f32);

impl Message for Celsius {
    const NAME: &'static str = "weather/Celsius";
    const HASH: u64 = schema::message("decimal", <Self as Schema>::HASH);
    type View = Box<Self>;

    fn schema() -> Option<String> {
        schema::message_text::<Self>("decimal")
    }

    fn bytes(&self) -> Result<std::borrow::Cow<'_, [u8]>, EncodeError> {
        Ok(self.0.to_string().into_bytes().into())
    }

    fn view(payload: Payload) -> Result<Box<Self>, PayloadError> {
        let text = String::from_utf8(payload.to_vec()).unwrap();
        Ok(Box::new(Self(text.parse().unwrap())))
    }
}

#[test]
fn a_message_of_an_encoding_of_its_own_has_a_text_too() {
    assert_eq!(text::<Celsius>(), "decimal:struct{0:f32,}");
    // No text for another encoding than the one in its hash.
    assert_eq!(schema::message_text::<Celsius>("plain"), None);
}

mod renamed {
    use super::*;

    #[derive(Message, Serialize, Deserialize, Debug, PartialEq)]
    #[message(name = "tests/Renamed", encoding = "json")]
    #[serde(rename_all = "camelCase", deny_unknown_fields)]
    pub(crate) struct Renamed {
        pub(crate) frame_id: String,
        #[serde(rename = "seq", default)]
        pub(crate) sequence: u64,
        pub(crate) metres: Metres,
        pub(crate) modes: Vec<Mode>,
    }

    #[derive(Schema, Serialize, Deserialize, Debug, PartialEq)]
    #[serde(transparent)]
    pub(crate) struct Metres {
        pub(crate) value: f64,
    }

    #[derive(Schema, Serialize, Deserialize, Debug, PartialEq)]
    #[serde(rename_all = "kebab-case", rename_all_fields = "UPPERCASE")]
    pub(crate) enum Mode {
        StandBy,
        #[serde(rename = "go_on")]
        GoOn {
            speed: u8,
        },
        #[serde(rename_all = "PascalCase")]
        FollowIt {
            max_speed: u8,
        },
    }
}

//= SM2-TYP-001 test
#[test]
fn a_message_as_json_has_the_names_that_serde_writes() {
    use renamed::{Metres, Mode, Renamed};
    assert_eq!(
        text::<Renamed>(),
        "json:struct{frameId:string,seq:u64,metres:f64,modes:list[enum{stand-by:struct{},\
         go_on:struct{SPEED:u8,},follow-it:struct{MaxSpeed:u8,},}],}"
    );
    let value = Renamed {
        frame_id: "map".to_owned(),
        sequence: u64::MAX,
        metres: Metres { value: 0.1 + 0.2 },
        modes: vec![
            Mode::StandBy,
            Mode::GoOn { speed: 1 },
            Mode::FollowIt { max_speed: 2 },
        ],
    };
    let bytes = value.bytes().unwrap().into_owned();
    let json = String::from_utf8(bytes.clone()).unwrap();
    assert_eq!(
        json,
        concat!(
            r#"{"frameId":"map","seq":18446744073709551615,"metres":0.30000000000000004,"#,
            r#""modes":["stand-by",{"go_on":{"SPEED":1}},{"follow-it":{"MaxSpeed":2}}]}"#
        )
    );
    assert_eq!(*Renamed::view(Payload::from(bytes)).unwrap(), value);
}

/// Under each of serde's rules, the schema has the names that serde writes.
#[test]
fn every_rule_of_renaming_is_serdes() {
    macro_rules! rules {
        ($($ident:ident $rule:literal)*) => { $({
            #[derive(Schema, Serialize, Deserialize)]
            #[serde(rename_all = $rule, rename_all_fields = $rule)]
            enum $ident { LikeThis { field_name: u8 }, HTTPServer2 { a: u8 } }

            let values = [$ident::LikeThis { field_name: 1 }, $ident::HTTPServer2 { a: 1 }];
            let mut text = String::new();
            assert!($ident::describe(&mut text));
            for value in values {
                let json = serde_json::to_string(&value).unwrap().replace('"', "");
                // {like-this:{field-name:1}} is like-this:struct{field-name:u8,}
                let variant = json.replace(":{", ":struct{").replace(":1}}", ":u8,}");
                let variant = variant.strip_prefix('{').unwrap();
                assert!(text.contains(variant), "{}: {text} has no {variant}", $rule);
            }
        })* };
    }
    rules! {
        Lower "lowercase"
        Upper "UPPERCASE"
        Pascal "PascalCase"
        Camel "camelCase"
        Snake "snake_case"
        ScreamingSnake "SCREAMING_SNAKE_CASE"
        Kebab "kebab-case"
        ScreamingKebab "SCREAMING-KEBAB-CASE"
    }
}

#[test]
fn json_that_is_no_message_is_an_error_that_names_the_type() {
    let wrong = |json: &str| {
        let payload = Payload::from(json.as_bytes().to_vec());
        renamed::Renamed::view(payload).unwrap_err().to_string()
    };
    let whole = r#"{"frameId":"","metres":1.5,"modes":[]}"#;
    let error = wrong(&format!("{whole} x"));
    assert!(
        error.contains("tests/Renamed") && error.contains("trailing"),
        "{error}"
    );
    assert!(wrong(&whole.replace("1.5", "null")).contains("f64"));
    assert!(wrong("{").contains("EOF"));
}
