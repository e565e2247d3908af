//! Definitions without Rust types, and where the error is.

use sm2_ros_build::{Builder, Error};

use crate::common::{Definitions, code_of};

/// The text of the error of a package with one file, with `p` for the path of the package.
fn error_of(file: &str, text: &str) -> String {
    let definitions = Definitions::new(&[(file, text)]);
    let error = definitions.builder().code().unwrap_err();
    let root = format!("{}/", definitions.root().display());
    error.to_string().replace(&root, "")
}

#[test]
fn a_wrong_value_is_reported_with_its_file_and_line() {
    // The name of the field is in a comment, too, and begins that of another one.
    let text = "# a 300\nuint8 ab 3\nuint8 b 3 # a 300\n\nuint8 a 300\n";
    let expected = "p/msg/T.msg: line 5: p/msg/T.a: 300 is not a value of the type uint8";
    assert_eq!(error_of("msg/T.msg", text), expected);
    let expected = "p/msg/T.msg: line 2: p/msg/T.A: x is not a value of the type int8";
    for constant in ["int8 A=x", "int8 A = x", "int8   A= x  # what"] {
        let text = format!("int8 B=1\n{constant}\n");
        assert_eq!(error_of("msg/T.msg", &text), expected, "{constant}");
    }
}

/// The types of a service and of an action are in one file.
#[test]
fn a_wrong_value_of_a_service_is_reported_with_its_line() {
    // Both parts have the field; the value tells them apart.
    let text = "uint8 a 1\n---\nuint8 a 300\n";
    let expected = "p/srv/S.srv: line 3: p/srv/S_Response.a: 300 is not a value of the type uint8";
    assert_eq!(error_of("srv/S.srv", text), expected);
    let text = "uint8 a 300\n---\nuint8 a 1\n";
    let expected = "p/srv/S.srv: line 1: p/srv/S_Request.a: 300 is not a value of the type uint8";
    assert_eq!(error_of("srv/S.srv", text), expected);
    // A `_` in the name of the service is not the end of the name of its file.
    let text = "---\nuint8 a 300\n";
    let expected =
        "p/srv/S_T.srv: line 2: p/srv/S_T_Response.a: 300 is not a value of the type uint8";
    assert_eq!(error_of("srv/S_T.srv", text), expected);
}

/// A message `T_U` is in `T_U.msg`, even if there is a message `T` with such a field.
#[test]
fn a_wrong_value_of_a_message_is_in_the_file_of_the_message() {
    let definitions = Definitions::new(&[
        ("msg/T.msg", "int32 a 300\n"),
        ("msg/T_U.msg", "\nuint8 a 300\n"),
    ]);
    match definitions.code() {
        Err(Error::Value { place, .. }) => {
            assert_eq!(place, Some((definitions.path("p/msg/T_U.msg"), 2)));
        }
        other => panic!("{other:?}"),
    }
}

/// Cargo prints the `Debug` text of the error of a build script.
#[test]
fn the_debug_text_of_an_error_is_its_text() {
    let error = code_of("uint8 a 300\n").unwrap_err();
    assert!(error.to_string().contains("line 1"), "{error}");
    assert_eq!(format!("{error:?}"), error.to_string());
}

#[test]
fn definitions_that_cannot_be_read_are_errors() {
    let error = error_of("msg/T.msg", "int32 a\nint32\n");
    assert!(error.starts_with("p/msg/T.msg: line 2: "), "{error}");
    let error = code_of("Missing a\n").unwrap_err();
    assert!(matches!(error, Error::Set(_)), "{error}");
    let nothing = tempfile::tempdir().unwrap();
    let error = Builder::new().package(nothing.path()).code().unwrap_err();
    assert!(matches!(error, Error::NoDefinitions(path) if path == nothing.path()));
}

#[test]
fn a_type_begins_with_an_upper_case_letter() {
    let definitions = Definitions::new(&[("msg/wheel.msg", "int8 a\n")]);
    let error = definitions.code().unwrap_err();
    assert!(
        matches!(&error, Error::TypeName(name) if name.name() == "wheel"),
        "{error}"
    );
}

#[test]
fn two_types_with_one_name_in_rust_are_refused() {
    let definitions = Definitions::new(&[("msg/A_B.msg", "int8 a\n"), ("msg/AB.msg", "int8 a\n")]);
    match definitions.code() {
        Err(Error::TypeTwice {
            first,
            second,
            rust,
        }) => {
            assert_eq!((first.name(), second.name(), &*rust), ("AB", "A_B", "AB"));
        }
        other => panic!("{other:?}"),
    }
    // In two modules, the same name is that of two types.
    let definitions = Definitions::new(&[("msg/AB.msg", "int8 a\n"), ("srv/AB.srv", "---\n")]);
    definitions.builder().code().unwrap();
}
