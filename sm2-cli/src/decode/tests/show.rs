//! Messages as people see them in a terminal.

use serde_json::json;

use super::{ALL, LINE, schema};
use crate::decode::{Limits, decode, encode, show};

fn shown(ty: &str, given: &serde_json::Value, limits: &Limits) -> String {
    let schema = schema(&format!("postcard:{ty}"));
    let bytes = encode(&schema, given).unwrap_or_else(|error| panic!("{error}"));
    show(&decode(&schema, &bytes, ALL).unwrap(), limits)
}

const PATH: &str = "struct{frame:string,mode:enum{Idle:struct{},Wait:struct{0:f32,},\
    Go:struct{0:u8,1:i8,},},points:list[struct{x:f64,y:f64,name:string,}],note:option[string],}";

#[test]
fn what_fits_is_on_one_line() {
    let given = json!({
        "frame": "map", "mode": { "Wait": 0.5 }, "points": [{ "x": 1, "y": -2.5, "name": "a" }],
    });
    let line =
        r#"{frame: "map", mode: Wait(0.5), points: [{x: 1.0, y: -2.5, name: "a"}], note: null}"#;
    assert_eq!(shown(PATH, &given, &LINE), line);
    let wide = Limits {
        width: line.len(),
        ..Limits::SCREEN
    };
    assert_eq!(shown(PATH, &given, &wide), line);
}

#[test]
fn what_does_not_fit_is_one_field_per_line() {
    let given = json!({
        "frame": "map", "mode": { "Go": [1, -1] },
        "points": [
            { "x": 1, "y": -2.5, "name": "the first of three" },
            { "x": 1, "y": -2.5, "name": "one that is so long that it is wider than any line could be" },
        ],
    });
    let expected = r#"
frame: "map"
mode: Go [1, -1]
points:
  - {x: 1.0, y: -2.5, name: "the first of three"}
  - x: 1.0
    y: -2.5
    name: "one that is so long that it is wider than any line could be"
note: null"#;
    assert_eq!(shown(PATH, &given, &Limits::SCREEN), expected.trim_start());
    let map = "map[string,struct{text:string,}]";
    let given = json!({ "a": { "text": "x".repeat(70) }, "b": { "text": "short" } });
    let expected = format!(
        "\"a\":\n  text: \"{}\"\n\"b\": {{text: \"short\"}}",
        "x".repeat(70)
    );
    assert_eq!(shown(map, &given, &Limits::SCREEN), expected);
}

/// The name, a colon and a blank take room on the line, too.
#[test]
fn a_value_goes_on_the_line_of_its_name_if_both_fit() {
    let ty = "struct{name:struct{a:u8,b:u8,},other:struct{a:u8,b:u8,},}";
    let given = json!({ "name": { "a": 1, "b": 2 }, "other": { "a": 3, "b": 4 } });
    for (width, expected) in [
        (19, "name: {a: 1, b: 2}\nother: {a: 3, b: 4}"),
        (18, "name: {a: 1, b: 2}\nother:\n  {a: 3, b: 4}"),
        (17, "name:\n  {a: 1, b: 2}\nother:\n  {a: 3, b: 4}"),
    ] {
        let limits = Limits {
            width,
            ..Limits::SCREEN
        };
        assert_eq!(shown(ty, &given, &limits), expected, "{width}");
    }
}

#[test]
fn long_lists_and_texts_are_cut_and_counted() {
    let numbers: Vec<u32> = (0..10_000).collect();
    let limits = Limits {
        elements: 10,
        characters: 4,
        ..LINE
    };
    assert_eq!(
        shown("list[u32]", &json!(numbers), &limits),
        "[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, … 9,990 more]"
    );
    assert_eq!(
        shown("string", &json!("grüße"), &limits),
        "\"grüß\" … 1 more"
    );
    // The count includes elements that the decoder left out.
    let schema = schema("plain:list[u8]");
    let head = decode(&schema, &[7; 2_000_000], 4).unwrap();
    assert_eq!(show(&head, &limits), "[7, 7, 7, 7, … 1,999,996 more]");
    assert_eq!(
        serde_json::to_string(&head).unwrap(),
        r#"[7,7,7,7,"… 1,999,996 more"]"#
    );
    let none = decode(&schema, &[7; 5], 0).unwrap();
    assert_eq!(show(&none, &limits), "[… 5 more]");
    let structs = vec![json!({ "s": "x".repeat(90) }); 3];
    let limits = Limits {
        elements: 1,
        ..Limits::SCREEN
    };
    let expected = format!("- s: \"{}\"\n… 2 more", "x".repeat(90));
    assert_eq!(
        shown("list[struct{s:string,}]", &json!(structs), &limits),
        expected
    );
}

#[test]
fn however_much_there_is_the_terminal_is_not_flooded() {
    let wide = json!(vec![vec![vec![vec![1; 40]; 40]; 40]; 2]);
    let text = shown("list[list[list[list[u8]]]]", &wide, &Limits::SCREEN);
    assert!(
        text.len() < Limits::SCREEN.total_bytes + 40,
        "{}",
        text.len()
    );
    assert!(text.ends_with("… (cut here)"), "{text}");
    let umlauts = json!("ä".repeat(100));
    let limits = Limits {
        total_bytes: 20,
        ..LINE
    };
    assert_eq!(
        shown("string", &umlauts, &limits),
        format!("\"{} … (cut here)", "ä".repeat(9))
    );
}

#[test]
fn nothing_reaches_the_terminal_as_a_command() {
    let evil = "\u{1b}[2J\u{9b}1m\u{202e}\0\r";
    let text = shown("string", &json!(evil), &Limits::SCREEN);
    assert!(
        !text.chars().any(char::is_control) && !text.contains('\u{202e}'),
        "{text:?}"
    );
    // The names in a schema are arbitrary.
    let name = "a\u{202e}\u{feff}";
    let text = shown(
        &format!("struct{{{name}:enum{{{name}:struct{{}},}},c:char,}}"),
        &json!({ name: name, "c": "\u{1b}" }),
        &Limits::SCREEN,
    );
    assert_eq!(text, r"{a\u{202e}\u{feff}: a\u{202e}\u{feff}, c: '\u{1b}'}");
}
