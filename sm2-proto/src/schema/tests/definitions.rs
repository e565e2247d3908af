//! Schema texts with definitions of ROS 2.

use alloc::{format, string::String};

use super::*;

const STRING: &str =
    "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

fn with(definition: &str) -> String {
    format!("cdr:{HASH}\n{definition}")
}

//= SM2-TYP-002 test
#[test]
fn a_definition_is_kept_with_the_hash_of_its_first_line() {
    let schema = parsed(STRING);
    assert_eq!(schema.encoding(), &Encoding::Cdr);
    let Root::Definition(definition) = schema.root() else {
        panic!("{schema:?}");
    };
    assert_eq!(definition.text(), "string data\n");
    assert_eq!(definition.rihs01()[..3], [0xdf, 0x66, 0x8c]);
    assert_eq!(definition.rihs01()[31], 0x18);
    assert_eq!(schema.to_string(), STRING);
    assert_eq!(parsed(&with("")).to_string(), with(""), "no fields");
    let beyond_ascii = with("string s \"\u{a0}größe\"\n");
    assert_eq!(parsed(&beyond_ascii).to_string(), beyond_ascii);
}

//= SM2-NAM-003 test
#[test]
fn the_hash_is_that_of_the_first_line() {
    let mut rihs01 = [0; 32];
    for (at, byte) in (0_u8..).zip(&mut rihs01) {
        *byte = at.wrapping_mul(37);
    }
    let digits: String = rihs01.iter().map(|byte| format!("{byte:02x}")).collect();
    let text = format!("cdr:RIHS01_{digits}");
    assert_eq!(hash::cdr(&rihs01), hash::text(&text));
    let definitions = ["", "uint8 x\n", "uint8 X=1\nuint8 x\n"];
    for definition in definitions {
        let schema = parsed(&format!("{text}\n{definition}"));
        assert_eq!(schema.hash(), hash::text(&text));
    }
}

//= SM2-TYP-002 test
#[test]
fn any_other_text_is_refused_and_the_place_named() {
    let digits = &HASH["RIHS01_".len()..];
    let cases = [
        (String::from("cdr:u8"), 4, Reason::Rihs01),
        (String::from("cdr:"), 4, Reason::Rihs01),
        (format!("cdr:rihs01_{digits}\n"), 4, Reason::Rihs01),
        (format!("cdr:RIHS02_{digits}\n"), 4, Reason::Rihs01),
        (format!("cdr:RIHS01_{}\n", &digits[1..]), 4, Reason::Rihs01),
        (format!("cdr:RIHS01_{digits}0\n"), 4, Reason::Rihs01),
        (
            format!("cdr:RIHS01_{}\n", digits.to_uppercase()),
            4,
            Reason::Rihs01,
        ),
        (format!("cdr:{HASH}"), 75, Reason::Expected('\n')),
        (format!("cdr:{HASH}\r\n"), 75, Reason::Expected('\n')),
        (format!("cdr: {HASH}\n"), 4, Reason::Rihs01),
        (with("uint8 x"), 83, Reason::Expected('\n')),
        (with("\n"), 76, Reason::Character),
        (with("uint8 x\n\n"), 84, Reason::Character),
        (with("uint8 x\r\n"), 83, Reason::Character),
        (with("uint8\tx\n"), 81, Reason::Character),
        (with("uint8 x\0\n"), 83, Reason::Character),
        (with("uint8 \u{7f}\n"), 82, Reason::Character),
        (with("uint8 \u{9f}\n"), 82, Reason::Character),
    ];
    for (text, at, reason) in cases {
        assert_eq!(wrong(&text), (at, reason), "{text:?}");
    }
    let longest = with(&format!("{}\n", "x".repeat(SCHEMA_TEXT_MAX - 77)));
    assert_eq!(longest.len(), SCHEMA_TEXT_MAX);
    assert_eq!(parsed(&longest).to_string(), longest);
    let longer = with(&format!("{}\n", "x".repeat(SCHEMA_TEXT_MAX - 76)));
    assert_eq!(wrong(&longer), (0, Reason::TooLong));
}
