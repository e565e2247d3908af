use std::collections::HashMap;
use std::ffi::OsString;

use proptest::collection::vec;
use proptest::prelude::*;

use super::environment::variable;
use super::file::{File, FileError};
use super::limits::{NAME_MAX, PARAMETERS_MAX, TABLE_MAX, TEXT_MAX, VALUE_MAX};
use super::refusal::{Refusal, WrongTable};
use super::resolve::resolve;
use super::table::{Assignment, Entry, Origin, SetParameters, SetParametersResult, Table};
use super::*;
use crate::Message;

fn entry(name: &str, value: Value) -> Entry {
    Entry {
        name: name.to_owned(),
        value,
        origin: Origin::Default,
        revision: 1,
        read_only: false,
        range: None,
        description: String::new(),
    }
}

fn table(parameters: Vec<Entry>) -> Table {
    Table {
        revision: 1,
        time_ns: 0,
        parameters,
    }
}

fn set(table: &Table, values: &[(&str, Value)]) -> Result<Option<Table>, Refusal> {
    let assignment = |(name, value): &(&str, Value)| Assignment {
        name: (*name).to_owned(),
        value: value.clone(),
    };
    table.set(&values.iter().map(assignment).collect::<Vec<_>>(), 7)
}

fn no_variables(_: &str) -> Option<OsString> {
    None
}

fn declared(parameters: Vec<Entry>, file: &str) -> Result<Table, ParametersError> {
    let file = File::parse("robot.toml", file)?;
    resolve(parameters, "lidar", &[file], &no_variables, 7)
}

//= SM2-PRM-001 test
#[test]
fn the_types_are_those_of_the_specification() {
    let spec = concat!(env!("CARGO_MANIFEST_DIR"), "/../SPEC.md");
    let spec = std::fs::read_to_string(spec).unwrap();
    let texts = [
        Table::schema(),
        SetParameters::schema(),
        SetParametersResult::schema(),
    ];
    for text in texts {
        let text = text.unwrap();
        assert!(spec.contains(&format!("\n{text}\n")), "SPEC lacks {text}");
    }
    assert_eq!(name("arm/left"), "parameters/arm/left");
    assert_eq!(node_of("parameters/arm/left"), Some("arm/left"));
    assert_eq!(node_of("arm/parameters"), None);
}

//= SM2-PRM-002 test
#[test]
fn a_change_has_the_next_revision() {
    let before = table(vec![entry("a", 1_i64.into()), entry("b", 1_i64.into())]);
    let after = set(&before, &[("b", 2_i64.into()), ("a", 1_i64.into())]);
    let after = after.unwrap().unwrap();
    assert_eq!((after.revision, after.time_ns), (2, 7));
    assert_eq!(after.parameters[0], before.parameters[0]);
    let b = &after.parameters[1];
    assert_eq!(
        (&b.value, b.origin, b.revision),
        (&Value::Integer(2), Origin::Set, 2)
    );
    assert_eq!(set(&after, &[("b", 2_i64.into())]), Ok(None));
    assert_eq!(set(&after, &[]), Ok(None));
}

//= SM2-PRM-003 test
#[test]
fn each_rule_refuses() {
    let mut parameters = vec![entry("a", 1.0.into()), entry("b", true.into())];
    parameters[0].range = Some(Range::Double {
        from: 0.0,
        to: 2.0,
        step: 0.0,
    });
    parameters[1].read_only = true;
    let table = table(parameters);
    let refused = |values: &[(&str, Value)]| set(&table, values).unwrap_err();
    let unknown = refused(&[("a", 1.5.into()), ("c", 1.0.into())]);
    assert!(matches!(unknown, Refusal::Unknown { name } if name == "c"));
    let twice = refused(&[("a", 1.5.into()), ("a", 1.5.into())]);
    assert!(matches!(twice, Refusal::Twice { .. }));
    let read_only = refused(&[("b", true.into())]);
    assert!(matches!(read_only, Refusal::ReadOnly { .. }));
    let of_type = refused(&[("a", 1_i64.into())]);
    let expected = "a has the type double, but the value has the type integer";
    assert_eq!(of_type.to_string(), expected);
    let out_of_range = refused(&[("a", 2.5.into())]);
    assert_eq!(
        out_of_range.to_string(),
        "a is 0.0 to 2.0, but the value is 2.5"
    );
    // A name that another process chose is cut off.
    let long = refused(&[(&"x".repeat(1_000), 1.0.into())]);
    assert!(long.to_string().len() < 400, "{long}");
}

//= SM2-PRM-003 test
#[test]
fn ranges_have_the_meaning_of_ros_2() {
    let integer = |from, to, step| Range::Integer { from, to, step };
    let range = integer(-3, 8, 5);
    let legal: Vec<i64> = (-10..20).filter(|&it| range.contains(&it.into())).collect();
    // The end is legal, although no step leads to it.
    assert_eq!(legal, [-3, 2, 7, 8]);
    let all = integer(i64::MIN, i64::MAX, 0);
    assert!(all.contains(&i64::MIN.into()) && all.contains(&i64::MAX.into()));
    assert!(!all.contains(&0.0.into()));
    let double = |from, to, step| Range::Double { from, to, step };
    let range = double(0.1, 1.0, 0.1);
    assert!((1..=10).all(|it| range.contains(&(f64::from(it) * 0.1).into())));
    assert!(
        ![0.0, 0.15, 1.1, f64::NAN, f64::INFINITY]
            .iter()
            .any(|&it| range.contains(&it.into()))
    );
    assert!(integer(1, 1, 0).is_valid() && !integer(2, 1, 0).is_valid());
    assert!(!double(0.0, f64::NAN, 0.0).is_valid() && !double(0.0, 1.0, -0.5).is_valid());
    assert!(!double(f64::NEG_INFINITY, 1.0, 0.0).is_valid());
}

//= SM2-PRM-004 test
#[test]
fn the_limits_hold() {
    let limits = (PARAMETERS_MAX, NAME_MAX, TEXT_MAX, VALUE_MAX, TABLE_MAX);
    assert_eq!(limits, (1_024, 255, 1_024, 65_536, 1_048_576));
    let of_len = |len: usize| entry("a", "x".repeat(len).into());
    // The variant and the length of the text take four bytes.
    assert!(declared(vec![of_len(VALUE_MAX - 4)], "").is_ok());
    let too_long = declared(vec![of_len(VALUE_MAX - 3)], "");
    assert!(matches!(
        too_long,
        Err(ParametersError::Default(Refusal::TooLong { .. }))
    ));
    let before = table(vec![of_len(0)]);
    let value = || Value::from("x".repeat(VALUE_MAX));
    assert!(matches!(
        set(&before, &[("a", value())]),
        Err(Refusal::TooLong { .. })
    ));

    let many = |count| {
        (0..count)
            .map(|it| entry(&it.to_string(), true.into()))
            .collect()
    };
    assert!(declared(many(PARAMETERS_MAX), "").is_ok());
    let too_many = declared(many(PARAMETERS_MAX + 1), "");
    assert!(matches!(too_many, Err(ParametersError::TooMany { .. })));
    assert!(table(many(PARAMETERS_MAX)).check().is_ok());
    let too_many = table(many(PARAMETERS_MAX + 1)).check();
    assert!(matches!(too_many, Err(WrongTable::TooMany { .. })));

    // Seventeen long texts do not fit into a table, sixteen short of it do.
    let names: Vec<_> = (0..17).map(|it| it.to_string()).collect();
    let before = table(
        names
            .iter()
            .map(|it| entry(it, String::new().into()))
            .collect(),
    );
    let long = Value::from("x".repeat(VALUE_MAX - 4));
    let all: Vec<_> = names.iter().map(|it| (it.as_str(), long.clone())).collect();
    assert!(set(&before, &all[..15]).unwrap().is_some());
    let too_long = set(&before, &all).unwrap_err();
    assert!(matches!(too_long, Refusal::TableTooLong { len } if len > TABLE_MAX));

    let mut described = entry("a", true.into());
    described.description = "x".repeat(TEXT_MAX + 1);
    let too_long = declared(vec![described.clone()], "");
    assert!(matches!(too_long, Err(ParametersError::Description { .. })));
    let too_long = table(vec![described]).check();
    assert!(matches!(too_long, Err(WrongTable::Description { .. })));
    let reason = SetParametersResult::refused("é".repeat(TEXT_MAX), 1).reason;
    assert_eq!(reason.len(), TEXT_MAX);
}

//= SM2-PRM-004 test
#[test]
fn names_follow_their_grammar() {
    let longest = "x".repeat(255);
    for legal in ["a", "max-range_2", "a.b.c", &longest] {
        assert!(
            declared(vec![entry(legal, true.into())], "").is_ok(),
            "{legal}"
        );
    }
    let too_long = "x".repeat(256);
    for wrong in [
        "", ".", "a.", ".a", "a..b", "a b", "a/b", "größe", &too_long,
    ] {
        let declared = declared(vec![entry(wrong, true.into())], "");
        assert!(
            matches!(declared, Err(ParametersError::Name { .. })),
            "{wrong}"
        );
        let received = table(vec![entry(wrong, true.into())]).check();
        assert!(matches!(received, Err(WrongTable::Name(_))), "{wrong}");
    }
    let twice = || vec![entry("a", true.into()), entry("a", true.into())];
    assert!(matches!(
        declared(twice(), ""),
        Err(ParametersError::Twice { .. })
    ));
    assert!(matches!(
        table(twice()).check(),
        Err(WrongTable::Twice { .. })
    ));
}

//= SM2-PRM-005 test
#[test]
fn a_table_whose_value_is_outside_of_its_range_is_wrong() {
    let mut wrong = entry("a", 3_i64.into());
    wrong.range = Some(Range::Integer {
        from: 0,
        to: 2,
        step: 0,
    });
    assert!(matches!(
        table(vec![wrong.clone()]).check(),
        Err(WrongTable::Value(_))
    ));
    wrong.range = Some(Range::Integer {
        from: 2,
        to: 0,
        step: 0,
    });
    assert!(matches!(
        table(vec![wrong]).check(),
        Err(WrongTable::Range { .. })
    ));
}

//= SM2-PRM-006 test
#[test]
fn a_later_place_takes_precedence() {
    let parameters = || {
        vec![
            entry("a.b", 1_i64.into()),
            entry("c", "x".to_owned().into()),
        ]
    };
    let file = |text| File::parse("robot.toml", text).unwrap();
    let first = file("['*']\na.b = 2\nc = 'all'\n[lidar]\nc = 'own'\n[other]\nz = 1");
    let second = file("[lidar.a]\nb = 3");
    let variables = HashMap::from([("SM2_PARAM_A_B", "4")]);
    let lookup = |name: &str| variables.get(name).map(OsString::from);
    let from = |files: &[File], lookup: &dyn Fn(&str) -> Option<OsString>| {
        let table = resolve(parameters(), "lidar", files, lookup, 7).unwrap();
        assert_eq!((table.revision, table.time_ns), (1, 7));
        let entries = table.parameters.into_iter();
        entries
            .map(|it| (it.value.to_string(), it.origin))
            .collect::<Vec<_>>()
    };
    let own = ("\"own\"".to_owned(), Origin::File);
    let none = from(&[], &no_variables);
    assert_eq!(none[0], ("1".to_owned(), Origin::Default));
    let one = from(std::slice::from_ref(&first), &no_variables);
    assert_eq!(one, [("2".to_owned(), Origin::File), own.clone()]);
    let two = from(&[first.clone(), second.clone()], &no_variables);
    assert_eq!(two[0], ("3".to_owned(), Origin::File));
    let all = from(&[first, second], &lookup);
    assert_eq!(all, [("4".to_owned(), Origin::Environment), own]);
}

#[test]
fn wrong_values_name_their_place() {
    let parameters = || vec![entry("a", 1_i64.into())];
    let text = |file| declared(parameters(), file).unwrap_err().to_string();
    let expected = "robot.toml:2: parameter a: integer is expected (such as 3), but this is a text";
    assert_eq!(text("[lidar]\na = 'x'"), expected);
    assert!(
        text("[lidar]\na = 9223372036854775808").contains(":2: parameter a: 9223372036854775808")
    );
    assert!(text("[lidar]\n\nb = 1").contains(":3: node lidar has no parameter b"));
    assert!(text("[lidar]\n[lidar.a]\nb = 1").contains(":3: node lidar has no parameter a.b"));
    assert!(text("a = 1\n").contains(":1: a is outside of the table of a node"));
    assert!(text("[lidar]\na = \n").starts_with("robot.toml:2: "));
    // A duplicate key is an error of TOML.
    assert!(text("[lidar]\na = 1\na = 2").starts_with("robot.toml:3: "));
    let error = File::load("/nowhere/robot.toml").unwrap_err();
    assert!(matches!(error, FileError::Read { .. }), "{error}");

    let of = |parameters, text: &str| {
        let lookup = |name: &str| (name == "SM2_PARAM_A").then(|| text.into());
        resolve(parameters, "lidar", &[], &lookup, 7)
            .unwrap_err()
            .to_string()
    };
    assert!(of(parameters(), "1.5").starts_with("environment variable SM2_PARAM_A: parameter a: "));
    let mut ranged = parameters();
    ranged[0].range = Some(Range::Integer {
        from: 0,
        to: 2,
        step: 0,
    });
    let expected = "environment variable SM2_PARAM_A: a is 0 to 2, but the value is 3";
    assert_eq!(of(ranged, "3"), expected);
    let two = vec![entry("a", 1_i64.into()), entry("A", 1_i64.into())];
    assert!(of(two, "1").contains("stands for the parameters a and A"));
    assert_eq!(variable("filter.max-size"), "SM2_PARAM_FILTER_MAX_SIZE");
}

#[test]
fn texts_are_values_of_their_type() {
    let parse = |kind: Kind, text| kind.parse(text).map(|it| it.to_string());
    assert_eq!(
        parse(Kind::String, "[1] = \"x\"").unwrap(),
        "\"[1] = \\\"x\\\"\""
    );
    assert_eq!(parse(Kind::Double, " 3 ").unwrap(), "3.0");
    assert_eq!(parse(Kind::Double, "-inf").unwrap(), "-inf");
    assert_eq!(parse(Kind::Double, "nan").unwrap(), "nan");
    assert_eq!(parse(Kind::Integer, "0xff").unwrap(), "255");
    assert_eq!(parse(Kind::ByteArray, "[0, 255]").unwrap(), "[0, 255]");
    assert_eq!(parse(Kind::DoubleArray, "[1, 2.5]").unwrap(), "[1.0, 2.5]");
    for (kind, text) in [
        (Kind::Bool, "yes"),
        (Kind::Integer, "1.0"),
        (Kind::Integer, ""),
        (Kind::Integer, "1\n2"),
        (Kind::Double, "1e999"),
        (Kind::Double, "9007199254740993"),
        (Kind::ByteArray, "[256]"),
        (Kind::ByteArray, "[-1]"),
        (Kind::BoolArray, "[true, 1]"),
        (Kind::StringArray, "a"),
        (Kind::StringArray, "[{}]"),
        (Kind::IntegerArray, "2020-01-01"),
    ] {
        let error = kind.parse(text).unwrap_err().to_string();
        assert!(error.contains(kind.word()), "{text}: {error}");
    }
}

fn any_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        any::<bool>().prop_map(Value::Bool),
        any::<i64>().prop_map(Value::Integer),
        any::<f64>().prop_map(Value::Double),
        any::<String>().prop_map(Value::String),
        vec(any::<u8>(), 0..9).prop_map(Value::ByteArray),
        vec(any::<bool>(), 0..9).prop_map(Value::BoolArray),
        vec(any::<i64>(), 0..9).prop_map(Value::IntegerArray),
        vec(any::<f64>(), 0..9).prop_map(Value::DoubleArray),
        vec(any::<String>(), 0..9).prop_map(Value::StringArray),
    ]
}

proptest! {
    /// A value that was written to a file is read as the same value.
    #[test]
    fn a_written_value_is_read_again(value in any_value()) {
        let text = format!("[lidar]\na = {value}\n");
        let file = File::parse("robot.toml", &text).unwrap();
        let read = file.values("lidar").next().unwrap().read(value.kind()).unwrap();
        // The same text rather than the same value: NaN is not equal to itself.
        prop_assert_eq!(read.to_string(), value.to_string());
        prop_assert_eq!(read.kind(), value.kind());
    }

    /// A table and a request come back from their encoding, and no bytes make the decoder panic.
    #[test]
    fn messages_survive_their_encoding(value in any_value(), bytes in vec(any::<u8>(), 0..200)) {
        let before = table(vec![entry("a", value)]);
        let decoded = Table::view(before.bytes().unwrap().into_owned().into()).unwrap();
        prop_assert_eq!(format!("{:?}", *decoded), format!("{before:?}"));
        if let Ok(table) = Table::view(bytes.clone().into()) {
            let _ = table.check();
        }
        if let Ok(request) = SetParameters::view(bytes.into()) {
            let _ = before.set(&request.parameters, 0);
        }
    }

    /// After a set, each parameter has the new value or, if one was refused, all have the old ones. The table is always
    /// legal.
    #[test]
    fn a_set_is_whole_and_legal(
        values in vec((0_usize..4, any_value()), 0..6),
        initial in vec(any_value(), 3),
    ) {
        let names = ["a", "b", "c", "d"];
        let entries = initial.into_iter().zip(names).map(|(value, name)| entry(name, value));
        let before = table(entries.collect());
        let values: Vec<_> = values.into_iter().map(|(at, value)| (names[at], value)).collect();
        match set(&before, &values) {
            Ok(Some(after)) => {
                prop_assert!(after.check().is_ok());
                for (name, value) in &values {
                    let now = &after.get(name).unwrap().value;
                    prop_assert_eq!(now.to_string(), value.to_string());
                }
            }
            Ok(None) => {
                let is_same = |(name, value): &(&str, Value)| before.get(name).unwrap().value == *value;
                prop_assert!(values.iter().all(is_same));
            }
            Err(_) => {
                let mut seen = std::collections::HashSet::new();
                let is_wrong = |(name, value): &(&str, Value)| {
                    let entry = before.get(name);
                    !seen.insert((*name).to_owned()) || entry.is_none_or(|it| it.kind() != value.kind())
                };
                prop_assert!(values.iter().any(is_wrong));
            }
        }
    }
}
