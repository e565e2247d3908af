//! The lines of a definition: types, names, values and quotes.

use sm2_ros_idl::{Base, Primitive, Reason, Set, Shape, TypeName};

/// The only field of a message: its name, its default value, and its comment.
fn field(line: &str) -> (String, Option<String>, String) {
    let name: TypeName = "p/msg/T".parse().unwrap();
    let mut set = Set::default();
    set.add(&name, line)
        .unwrap_or_else(|error| panic!("{line}: {error}"));
    let fields = &set.get(&name).unwrap().fields;
    let [field] = fields.as_slice() else {
        panic!("{line}: {fields:?}");
    };
    let default = field.default.as_ref().map(ToString::to_string);
    (field.name.to_string(), default, field.comment.to_string())
}

/// The rule that a line breaks.
fn reason(line: &str) -> Reason {
    let name: TypeName = "p/msg/T".parse().unwrap();
    let error = Set::default().add(&name, line).unwrap_err();
    assert_eq!(error.line, 1, "{line}");
    error.reason
}

#[test]
fn a_comment_begins_outside_of_quotes() {
    for (line, default, comment) in [
        (r#"string a "x # y" # c"#, r#""x # y""#, "c"),
        (r"string a 'x # y' # c", "'x # y'", "c"),
        // A quote of the other kind is a letter.
        (r#"string a "it's # y" # c"#, r#""it's # y""#, "c"),
        (r#"string a '5" # y' # c"#, r#"'5" # y'"#, "c"),
        // A backslash takes the meaning of the quote behind it, or of another backslash.
        (r#"string a "x\" # y" # c"#, r#""x\" # y""#, "c"),
        (r#"string a "x\\" # 5" wide"#, r#""x\\""#, r#"5" wide"#),
        (r#"string a "x\n # y" # c"#, r#""x\n # y""#, "c"),
        // Outside of quotes it has none.
        (r#"string a \"x # y" # c"#, r#"\"x # y""#, "c"),
        // An apostrophe in a value without quotes opens nothing.
        ("string a it's # c", "it's", "c"),
        ("string a it's", "it's", ""),
        ("uint8[] a [1, 2] # [3]", "[1, 2]", "[3]"),
        ("string a x#c", "x", "c"),
    ] {
        let expected = ("a".into(), Some(default.into()), comment.into());
        assert_eq!(field(line), expected, "{line}");
    }
}

#[test]
fn spaces_separate_a_type_its_name_and_its_value() {
    for line in ["int8 a", "int8\ta", "  int8   a  ", "int8 a\r"] {
        assert_eq!(field(line), ("a".into(), None, String::new()), "{line:?}");
    }
    for line in ["int8 a 5", "int8 a\t5", "int8  a   5  "] {
        assert_eq!(field(line).1.as_deref(), Some("5"), "{line:?}");
    }
    let name: TypeName = "p/msg/T".parse().unwrap();
    for line in ["int8 A=5", "int8 A = 5", "int8  A= 5 # c", "int8 A =5"] {
        let mut set = Set::default();
        set.add(&name, line).unwrap();
        let message = set.get(&name).unwrap();
        assert!(message.fields.is_empty(), "{line}");
        let [constant] = message.constants.as_slice() else {
            panic!("{line}: {:?}", message.constants);
        };
        assert_eq!((&*constant.name, &*constant.value), ("A", "5"), "{line}");
    }
}

/// rosidl writes annotations as lines that begin with `@`.
#[test]
fn annotations_are_no_fields() {
    assert_eq!(field("@unit(value=\"m\")\nint8 a").0, "a");
}

#[test]
fn a_member_name_has_letters_digits_and_underscores() {
    for name in ["a", "aB_1", "a_", "A9"] {
        assert_eq!(field(&format!("int8 {name}")).0, name);
    }
    for name in ["_a", "1a", "a-b", "a.b", "ä"] {
        assert_eq!(
            reason(&format!("int8 {name}")),
            Reason::IllegalName(name.into())
        );
    }
    assert_eq!(reason("int8 =1"), Reason::IllegalName(String::new()));
}

#[test]
fn a_type_has_a_base_and_a_shape() {
    let message = |name: &str| Base::Message(name.parse().unwrap());
    let name: TypeName = "p/msg/T".parse().unwrap();
    let max_bytes = Some(5);
    for (ty, base, shape) in [
        ("int8", Base::Primitive(Primitive::Int8), Shape::One),
        ("int8[3]", Base::Primitive(Primitive::Int8), Shape::Array(3)),
        ("int8[1]", Base::Primitive(Primitive::Int8), Shape::Array(1)),
        (
            "int8[]",
            Base::Primitive(Primitive::Int8),
            Shape::Sequence(None),
        ),
        (
            "int8[<=1]",
            Base::Primitive(Primitive::Int8),
            Shape::Sequence(Some(1)),
        ),
        ("string", Base::String { max_bytes: None }, Shape::One),
        ("string<=5", Base::String { max_bytes }, Shape::One),
        (
            "string<=5[<=2]",
            Base::String { max_bytes },
            Shape::Sequence(Some(2)),
        ),
        ("wstring", Base::WString { max_units: None }, Shape::One),
        (
            "wstring<=5[2]",
            Base::WString { max_units: Some(5) },
            Shape::Array(2),
        ),
        ("U", message("p/msg/U"), Shape::One),
        ("q/U[]", message("q/msg/U"), Shape::Sequence(None)),
        ("q/msg/U", message("q/msg/U"), Shape::One),
        ("q/srv/S_Request", message("q/srv/S_Request"), Shape::One),
        ("q/action/A_Goal", message("q/action/A_Goal"), Shape::One),
    ] {
        let mut set = Set::default();
        set.add(&name, &format!("{ty} a")).unwrap();
        let field = &set.get(&name).unwrap().fields[0].ty;
        assert_eq!((&field.base, field.shape), (&base, shape), "{ty}");
    }
    for limit in ["0", "-1", "4294967296", "x", "<=0", "<=", "<3"] {
        let text = limit.strip_prefix("<=").unwrap_or(limit);
        assert_eq!(
            reason(&format!("int8[{limit}] a")),
            Reason::Limit(text.into()),
            "{limit}"
        );
    }
}

#[test]
fn a_reference_is_a_name_of_one_to_three_legal_parts() {
    let longest = "U".repeat(120);
    assert_eq!(field(&format!("{longest} a")).0, "a");
    for ty in [
        &format!("{longest}U"),
        "_U",
        "1U",
        "U-V",
        "/U",
        "q/",
        "q/other/U",
        "q/msg/U/V",
        "q//U",
    ] {
        assert!(
            matches!(reason(&format!("{ty} a")), Reason::Type(_)),
            "{ty}"
        );
    }
}

#[test]
fn constants_have_values_of_primitives_and_texts() {
    for ty in ["int8", "string", "string<=5", "wstring", "bool"] {
        let name: TypeName = "p/msg/T".parse().unwrap();
        Set::default().add(&name, &format!("{ty} A=1")).unwrap();
        assert_eq!(reason(&format!("{ty}[] A=1")), Reason::ConstantType);
        assert_eq!(reason(&format!("{ty} A=  ")), Reason::ConstantValue);
    }
}

/// The sections of a service and an action are separated by lines `---`.
#[test]
fn services_and_actions_have_their_sections() {
    for (name, separators) in [("p/msg/T", 0), ("p/srv/T", 1), ("p/action/T", 2)] {
        let name: TypeName = name.parse().unwrap();
        for found in 0..5 {
            let text = "int8 a\n".to_owned() + &"--- \nint8 a\n".repeat(found);
            let error = Set::default().add(&name, &text).err();
            let reason = (found != separators).then_some(Reason::Sections {
                expected: separators,
                found,
            });
            assert_eq!(error.map(|it| it.reason), reason, "{name} {found}");
        }
    }
    // The numbers of lines are those in the file.
    let name: TypeName = "p/srv/T".parse().unwrap();
    let error = Set::default()
        .add(&name, "int8 a\n---\n\nint8\n")
        .unwrap_err();
    assert_eq!((error.line, error.reason), (4, Reason::Name));
}
