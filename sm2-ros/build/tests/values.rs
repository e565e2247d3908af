//! The values of constants and the default values of fields.

use sm2_ros_build::Error;

use crate::common::{assert_lines, code_of};

/// Asserts that a constant of this type has this value in Rust.
fn assert_constant(ty: &str, text: &str, expected: &str) {
    let code = code_of(&format!("{ty} A={text}\n")).unwrap_or_else(|error| panic!("{error}"));
    assert_lines(&code, &[&format!("pub const A: {expected};")]);
}

/// Asserts that a text is not a value of the type, as a constant and as a default value.
fn assert_refused(ty: &str, text: &str) {
    let constant = match ty.contains('[') {
        true => None,
        false => Some(format!("{ty} A={text}\n")),
    };
    for definition in constant.into_iter().chain([format!("{ty} a {text}\n")]) {
        match code_of(&definition) {
            Err(Error::Value { value, .. }) => assert_eq!(value, text, "{definition}"),
            other => panic!("{definition}: {other:?}"),
        }
    }
}

#[test]
fn each_integer_type_has_its_least_and_greatest_value() {
    for (ty, rust, least, greatest) in [
        ("int8", "i8", i128::from(i8::MIN), i128::from(i8::MAX)),
        ("uint8", "u8", 0, u8::MAX.into()),
        ("byte", "u8", 0, u8::MAX.into()),
        ("char", "u8", 0, u8::MAX.into()),
        ("int16", "i16", i16::MIN.into(), i16::MAX.into()),
        ("uint16", "u16", 0, u16::MAX.into()),
        ("int32", "i32", i32::MIN.into(), i32::MAX.into()),
        ("uint32", "u32", 0, u32::MAX.into()),
        ("int64", "i64", i64::MIN.into(), i64::MAX.into()),
        ("uint64", "u64", 0, u64::MAX.into()),
    ] {
        for value in [least, greatest, 7] {
            assert_constant(ty, &value.to_string(), &format!("{rust} = {value}"));
        }
        assert_refused(ty, &(least - 1).to_string());
        assert_refused(ty, &(greatest + 1).to_string());
    }
}

#[test]
fn integers_have_a_sign_and_a_radix() {
    for (text, value) in [
        ("-7", -7),
        ("+7", 7),
        ("0x1f", 31),
        ("0X1F", 31),
        ("-0x10", -16),
        ("0o17", 15),
        ("0b101", 5),
        ("-0b1", -1),
    ] {
        assert_constant("int16", text, &format!("i16 = {value}"));
    }
    for text in [
        "--7", "-+7", "+-7", "0x", "0x-1", "0b2", "7.0", "seven", "\"7\"",
    ] {
        assert_refused("int16", text);
    }
}

#[test]
fn booleans_are_words_or_digits() {
    for text in ["true", "True", "TRUE", "1"] {
        assert_constant("bool", text, "bool = true");
    }
    for text in ["false", "False", "FALSE", "0"] {
        assert_constant("bool", text, "bool = false");
    }
    assert_refused("bool", "2");
    assert_refused("bool", "yes");
}

#[test]
fn floats_are_finite() {
    for (ty, rust) in [("float32", "f32"), ("float64", "f64")] {
        assert_constant(ty, "-1.5", &format!("{rust} = -1.5"));
        assert_constant(ty, "2e3", &format!("{rust} = 2000.0"));
        for text in ["nan", "inf", "-inf", "1e999", "one"] {
            assert_refused(ty, text);
        }
    }
    // The type decides which numbers are too large.
    code_of("float64 A=1e39\n").unwrap();
    assert_refused("float32", "1e39");
}

#[test]
fn texts_lose_their_quotes_and_keep_their_limit() {
    let text = "&'static str";
    for (ty, value, expected) in [
        ("string", "\"a b\"", "\"a b\""),
        ("string", "'a'", "\"a\""),
        ("string", "plain", "\"plain\""),
        // Only a pair of quotes is taken off.
        ("string", "a\"", "\"a\\\"\""),
        ("string", "\"\"", "\"\""),
        ("string<=3", "\"abc\"", "\"abc\""),
        // Three bytes in UTF-8, but one unit in UTF-16.
        ("string<=3", "\"€\"", "\"€\""),
        ("wstring<=3", "\"€€€\"", "\"€€€\""),
    ] {
        assert_constant(ty, value, &format!("{text} = {expected}"));
    }
    assert_refused("string<=3", "\"abcd\"");
    assert_refused("string<=3", "\"€a\"");
    assert_refused("wstring<=3", "\"abcd\"");
    // Two units each.
    assert_refused("wstring<=3", "\"😀😀\"");
}

/// The expression of a field in the generated `Default`, for a field `a` of this type.
fn assert_default(definition: &str, expected: &str) {
    let code = code_of(definition).unwrap_or_else(|error| panic!("{definition}: {error}"));
    let implementation = code
        .split_once("fn default() -> Self {")
        .map(|(_, rest)| rest);
    let (_, value) = implementation
        .and_then(|it| it.split_once("Self {"))
        .unwrap_or_else(|| panic!("{definition}: no Default in:\n{code}"));
    let squeezed = |text: &str| text.split_whitespace().collect::<String>();
    let expected = squeezed(&format!("a: {expected}"));
    let value = squeezed(value);
    let rest = value.strip_prefix(&expected);
    let rest = rest.unwrap_or_else(|| panic!("{definition}: {expected} in {value}"));
    assert!(rest.starts_with(['}', ',']), "{definition}: {value}");
}

#[test]
fn fields_have_the_default_values_of_the_definition() {
    for (definition, expected) in [
        ("int32 a -7\n", "-7"),
        ("float32 a 1.5\n", "1.5"),
        ("bool a true\n", "true"),
        ("string a \"b c\"\n", "::std::string::String::from(\"b c\")"),
        ("wstring a 'b'\n", "::std::string::String::from(\"b\")"),
        ("uint8[3] a [1, 2, 3]\n", "[1, 2, 3]"),
        ("uint8[] a [1, 2]\n", "::std::vec![1, 2]"),
        ("uint8[] a []\n", "::std::vec![]"),
        ("uint8[<=2] a [ 1 ,2 ]\n", "::std::vec![1, 2]"),
        // A comma inside quotes, and a quote of the other kind, separate nothing.
        (
            "string[] a [\"b, c\", 'd\"', \"\"]\n",
            "::std::vec![::std::string::String::from(\"b,c\"), ::std::string::String::from(\"d\\\"\"), \
             ::std::string::String::from(\"\")]",
        ),
    ] {
        assert_default(definition, expected);
    }
}

#[test]
fn default_values_fit_the_number_of_elements() {
    for (ty, text) in [
        ("uint8[3]", "[1, 2]"),
        ("uint8[3]", "[1, 2, 3, 4]"),
        ("uint8[<=2]", "[1, 2, 3]"),
        ("uint8[]", "[1, 256]"),
        ("uint8[]", "1"),
        ("uint8[]", "[1"),
        ("uint8[]", "1]"),
        ("uint8[]", "[1,]"),
        ("string<=2[]", "[\"ab\", \"abc\"]"),
    ] {
        assert_refused(ty, text);
    }
}

/// Rust derives no `Default` of large arrays, so the code has the values.
#[test]
fn fields_without_a_default_value_are_zero() {
    let also = "int8 other 1\n";
    for (definition, expected) in [
        ("uint8[40] a\n", "[0; 40]"),
        ("bool[40] a\n", "[false; 40]"),
        ("float64[40] a\n", "[0.0; 40]"),
        (
            "string[40] a\n",
            "::core::array::from_fn(|_| ::core::default::Default::default())",
        ),
        (
            &format!("uint8[] a\n{also}"),
            "::core::default::Default::default()",
        ),
        (
            &format!("string a\n{also}"),
            "::core::default::Default::default()",
        ),
    ] {
        assert_default(definition, expected);
    }
    let code = code_of("uint8[] a\nstring b\n").unwrap();
    assert_lines(&code, &["#[derive(Clone, Debug, PartialEq, Default)]"]);
    let code = code_of("uint8[] a [1]\nstring b\n").unwrap();
    assert_lines(&code, &["#[derive(Clone, Debug, PartialEq)]"]);
}
