//! The types of fields, their codecs, and the views that are read in place.

use crate::common::{Definitions, assert_lines, code_of};

/// Without spaces, so that the form of the code does not matter.
fn squeezed(text: &str) -> String {
    text.split_whitespace().collect()
}

/// The table of the crate's documentation.
#[test]
fn fields_have_the_documented_types() {
    for (ty, rust) in [
        ("bool", "bool"),
        ("byte", "u8"),
        ("char", "u8"),
        ("int8", "i8"),
        ("uint8", "u8"),
        ("int16", "i16"),
        ("uint16", "u16"),
        ("int32", "i32"),
        ("uint32", "u32"),
        ("int64", "i64"),
        ("uint64", "u64"),
        ("float32", "f32"),
        ("float64", "f64"),
        ("string", "::std::string::String"),
        ("wstring<=4", "::std::string::String"),
        ("int8[5]", "[i8; 5]"),
        ("int8[]", "::std::vec::Vec<i8>"),
        ("string[<=5]", "::std::vec::Vec<::std::string::String>"),
    ] {
        let code = code_of(&format!("{ty} a\n")).unwrap();
        assert_lines(&code, &[&format!("pub a: {rust},")]);
    }
}

/// `sm2-ros` compares the bytes of all common interfaces with the codec that works by definitions. This test has the
/// cases that no common interface has.
#[test]
fn limits_are_passed_to_the_codec_in_both_directions() {
    for (ty, written, read) in [
        (
            "string<=5",
            "text(&self.a,::core::option::Option::Some(5))",
            "string(::core::option::Option::Some(5))",
        ),
        (
            "string",
            "text(&self.a,::core::option::Option::None)",
            "string(::core::option::Option::None)",
        ),
        (
            "wstring<=5",
            "wide_text(&self.a,::core::option::Option::Some(5))",
            "wide_string(::core::option::Option::Some(5))",
        ),
        (
            "int8[<=5]",
            "number_sequence(&self.a,::core::option::Option::Some(5))",
            "number_sequence(::core::option::Option::Some(5))",
        ),
        (
            "bool[<=5]",
            "sequence(&self.a,::core::option::Option::Some(5),",
            "sequence(::core::option::Option::Some(5),1,",
        ),
        (
            "string[<=5]",
            "sequence(&self.a,::core::option::Option::Some(5),",
            "sequence(::core::option::Option::Some(5),4,",
        ),
    ] {
        let code = squeezed(&code_of(&format!("{ty} a\n")).unwrap());
        for part in [format!("writer.{written}"), format!("reader.{read}")] {
            assert!(code.contains(&part), "{ty}: no {part} in {code}");
        }
    }
}

/// The least size keeps a short message from promising a long sequence.
#[test]
fn types_state_the_least_bytes_of_a_message() {
    for (text, expected) in [
        ("", "1"),
        ("int8 a\nfloat64 b\n", "1+8"),
        ("int16[5] a\nbool b\n", "5*2+1"),
        ("string a\nwstring b\nint64[] c\nstring[<=3] d\n", "4+4+4+4"),
        ("string[3] a\n", "3*4"),
    ] {
        let code = squeezed(&code_of(text).unwrap());
        let part = format!("constMIN_BYTES:usize={expected};");
        assert!(code.contains(&part), "{text}: no {part} in {code}");
    }
}

/// Numbers are written and read all at once, and other elements one by one.
#[test]
fn arrays_of_numbers_are_copied_as_a_whole() {
    let code = squeezed(&code_of("int16[5] a\nbool[2] b\nfloat64[] c\nstring[] d\n").unwrap());
    // The view is read, too.
    for (part, count) in [
        ("writer.numbers(&self.a)", 1),
        ("writer.each(&self.b,", 1),
        ("writer.number_sequence(&self.c,", 1),
        ("writer.sequence(&self.d,", 1),
        ("reader.number_array()", 2),
        ("reader.array(|reader|", 2),
        ("reader.number_sequence(", 1),
        ("reader.sequence(", 2),
    ] {
        assert_eq!(code.matches(part).count(), count, "{part}: {code}");
    }
}

/// Sequences of numbers stay in the message; other fields are as in the type.
#[test]
fn views_have_sequences_of_numbers_in_place() {
    let code = Definitions::new(&[
        (
            "msg/T.msg",
            "int16[] a\nint16[4] b\nbool[] c\nstring d\nU e\nU[] f\nU[2] g\nN h\n",
        ),
        ("msg/U.msg", "uint8[<=9] a\n"),
        ("msg/N.msg", "int8[3] a\nstring[] b\nbool[] c\n"),
    ]);
    let code = code.code().unwrap();
    let (_, views) = code.split_once("pub mod view {").unwrap();
    let (of_t, of_u) = views.split_once("pub struct U<'a> {").unwrap();
    let u = "<super::super::super::p::msg::U as ::sm2_ros::Viewed>::View<'a>";
    let n = "<super::super::super::p::msg::N as ::sm2_ros::Viewed>::View<'a>";
    assert_lines(
        of_t,
        &[
            "pub struct T<'a> {",
            "pub a: ::sm2_ros::cdr::Numbers<'a, i16>,",
            "pub b: [i16; 4],",
            "pub c: ::std::vec::Vec<bool>,",
            "pub d: ::std::string::String,",
            &format!("pub e: {u},"),
            &format!("pub h: {n},"),
        ],
    );
    let squeezed_views = squeezed(of_t);
    for field in ["f", "g"] {
        let part = squeezed(&format!("pub {field}: ::std::vec::Vec<{u}>")).replace(",>", ">");
        let views = squeezed_views.replace(",>", ">");
        assert!(views.contains(&part), "no {part} in {views}");
    }
    assert_lines(of_u, &["pub a: ::sm2_ros::cdr::Numbers<'a, u8>,"]);
    // A type without numbers is its own view.
    assert!(!views.contains("struct N"), "{views}");
    assert_lines(
        &code,
        &["type View<'a> = Self;", "type View<'a> = view::U<'a>;"],
    );
}
