//! The text of a type with those that it refers to, which bags have.

use sm2_ros_idl::{DefinitionError, Reason, Set, TypeName};

fn name(text: &str) -> TypeName {
    text.parse().unwrap()
}

#[test]
fn a_text_has_all_parts_of_the_definition_but_comments() {
    let mut set = Set::default();
    let text = "# c\nint8 A = 1\nstring B=\"x\"\n\nint8 a -1 # c\nq/U[<=3] u\nV[2] v\nstring<=5[] s [\"t\"]\n";
    set.add(&name("p/msg/T"), text).unwrap();
    set.add(&name("q/msg/U"), "wstring<=2 w\n").unwrap();
    set.add(&name("p/msg/V"), "").unwrap();
    let line = "=".repeat(80);
    let expected = format!(
        "int8 A=1\nstring B=\"x\"\nint8 a -1\nq/U[<=3] u\np/V[2] v\nstring<=5[] s [\"t\"]\n\
         {line}\nMSG: p/V\n{line}\nMSG: q/U\nwstring<=2 w\n"
    );
    assert_eq!(set.text(&name("p/msg/T")).unwrap(), expected);
}

/// A part of a service keeps the middle of its name, so that the text leads back to it.
#[test]
fn a_text_names_the_parts_of_a_service_in_full() {
    let mut set = Set::default();
    set.add(&name("service_msgs/msg/ServiceEventInfo"), "int8 kind\n")
        .unwrap();
    set.add(&name("p/srv/S"), "int8 a\n---\nint8 b\n").unwrap();
    let text = set.text(&name("p/srv/S")).unwrap();
    assert!(
        text.starts_with("p/srv/S_Request request_message\n"),
        "{text}"
    );
    assert!(
        text.contains("\nMSG: service_msgs/ServiceEventInfo\n"),
        "{text}"
    );
    assert!(text.contains("\nMSG: p/srv/S_Request\n"), "{text}");
}

/// Other programs write other lines of `=`, but at least three.
#[test]
fn a_line_of_three_or_more_equals_signs_separates_definitions() {
    let parse = |line: &str| {
        let text = format!("U u\n{line}\nMSG: p/U\nint8 a\n");
        Set::parse(&name("p/msg/T"), &text)
    };
    for line in ["===", "====", "===  ", &"=".repeat(80)] {
        let set = parse(line).unwrap();
        assert!(set.get(&name("p/msg/U")).is_ok(), "{line}");
        assert!(set.hash(&name("p/msg/T")).is_ok(), "{line}");
    }
    for line in ["==", "==x", "=x=", "x"] {
        let error = parse(line).unwrap_err();
        assert_eq!((error.line, error.reason), (2, Reason::Name), "{line}");
    }
    // An empty line is not a separator either.
    let error = parse("").unwrap_err();
    assert_eq!(error.line, 3);
}

#[test]
fn wrong_texts_have_the_number_of_the_line() {
    let parse = |text: &str| -> DefinitionError { Set::parse(&name("p/msg/T"), text).unwrap_err() };
    for (text, line, reason) in [
        ("U u\n===\n", 3, Reason::Header),
        ("U u\n\n===\nmsg: p/U\n", 4, Reason::Header),
        ("===\nMSG: p/U\nint8 a\nint8\n", 4, Reason::Name),
        ("===\nMSG: p/U\n===\nMSG: p/V\nint8\n", 5, Reason::Name),
    ] {
        let error = parse(text);
        assert_eq!((error.line, error.reason), (line, reason), "{text:?}");
    }
    let error = parse("===\nMSG: U-V\n");
    assert!(matches!(error.reason, Reason::Type(_)), "{error}");
    assert_eq!(error.line, 2);
}
