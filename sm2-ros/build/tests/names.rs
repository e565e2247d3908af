//! The names of types and fields in Rust, and their modules.

use crate::common::{Definitions, assert_lines, code_of};

#[test]
fn fields_with_the_names_of_keywords_are_raw_or_get_an_underscore() {
    let text = "int8 type\nint8 self\nint8 super\nint8 crate\nint8 fn=1\nint8 plain\n";
    let code = code_of(text).unwrap();
    let fields = ["r#type", "self_", "super_", "crate_", "plain"];
    let fields = fields.map(|it| format!("pub {it}: i8,"));
    assert_lines(&code, &fields.each_ref().map(String::as_str));
    assert_lines(&code, &["pub const r#fn: i8 = 1;"]);
}

/// The table of the crate's documentation.
#[test]
fn a_service_and_an_action_have_the_documented_types() {
    let code = Definitions::new(&[
        ("srv/AddTwoInts.srv", "int64 a\nint64 b\n---\nint64 sum\n"),
        ("action/Dock.action", "int8 a\n---\nint8 b\n---\nint8 c\n"),
    ]);
    let code = code.builder().code().unwrap();
    for (name, kind) in [
        ("AddTwoInts", "Service"),
        ("Dock", "Action"),
        ("DockSendGoal", "Service"),
        ("DockGetResult", "Service"),
    ] {
        let implementation = format!("impl ::sm2_ros::{kind} for {name} {{");
        assert_lines(&code, &[&format!("pub enum {name} {{}}"), &implementation]);
    }
    for name in [
        "AddTwoIntsRequest",
        "AddTwoIntsResponse",
        "AddTwoIntsEvent",
        "DockGoal",
        "DockResult",
        "DockFeedback",
        "DockFeedbackMessage",
        "DockSendGoalRequest",
        "DockGetResultResponse",
    ] {
        assert_lines(&code, &[&format!("pub struct {name} {{")]);
    }
    assert_lines(
        &code,
        &[
            "const NAME: &'static str = \"p/srv/AddTwoInts\";",
            "type Request = super::super::p::srv::AddTwoIntsRequest;",
            "type Response = super::super::p::srv::AddTwoIntsResponse;",
            "type Event = super::super::p::srv::AddTwoIntsEvent;",
            "const NAME: &'static str = \"p/action/Dock\";",
            "type Goal = super::super::p::action::DockGoal;",
            "type Feedback = super::super::p::action::DockFeedback;",
            "type SendGoal = super::super::p::action::DockSendGoal;",
            "type GetResult = super::super::p::action::DockGetResult;",
            "visitor.visit::<p::srv::AddTwoIntsRequest>();",
        ],
    );
    // A service and an action have no bytes of their own.
    assert!(!code.contains("visit::<p::srv::AddTwoInts>"), "{code}");
    assert!(!code.contains("visit::<p::action::Dock>"), "{code}");
}

/// A message is a message, even if others have its name with the suffixes of a service or action.
#[test]
fn a_message_is_no_service() {
    let parts = ["Request", "Response", "SendGoal", "GetResult"];
    let definitions = Definitions::new(&[("msg/T.msg", "int8 a\n")]);
    for part in parts {
        definitions.write(&format!("p/msg/T_{part}.msg"), "int8 a\n");
    }
    let code = definitions.code().unwrap();
    assert_lines(&code, &["pub struct T {", "pub struct TRequest {"]);
}

#[test]
fn comments_are_documentation_as_they_are() {
    let code = code_of("# Of all.\n\n# One.\nint8 a # two\nint8 b # ```\nint8 c\n").unwrap();
    let has = |text: &str| assert!(code.contains(text), "no {text:?} in:\n{code}");
    has("`p/msg/T`\n\n```text\nOf all.\n```");
    has("`int8 a`\n\n```text\nOne.\ntwo\n```");
    // The comment does not end the block that it is in.
    has("`int8 b`\n\n```text\n'''\n```");
    assert_lines(&code, &["/// `int8 c`"]);
}
