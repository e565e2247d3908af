//! The types that one definition file stands for: a message, or the derived types of a service or action.

use crate::{
    Base, DefinitionError, Field, FieldType, Kind, Message, NameError, Primitive, Reason, Shape,
    TypeName, parse,
};

/// Reads a file. A service has the types `_Request`, `_Response`, `_Event` and itself; an action has `_Goal`,
/// `_Result`, `_Feedback`, `_FeedbackMessage`, the services `_SendGoal` and `_GetResult`, and itself.
pub(crate) fn messages(name: &TypeName, text: &str) -> Result<Vec<Message>, DefinitionError> {
    let mut sections = vec![Vec::new()];
    for (at, line) in text.lines().enumerate() {
        match (line.trim_end(), sections.last_mut()) {
            ("---", _) => sections.push(Vec::new()),
            (_, Some(section)) => section.push((at + 1, line)),
            (_, None) => {}
        }
    }
    let suffixes: &[&str] = match name.kind() {
        Kind::Msg => &[""],
        Kind::Srv => &["_Request", "_Response"],
        Kind::Action => &["_Goal", "_Result", "_Feedback"],
    };
    if sections.len() != suffixes.len() {
        return Err(DefinitionError {
            line: text.lines().count(),
            reason: Reason::Sections {
                expected: suffixes.len() - 1,
                found: sections.len() - 1,
            },
        });
    }
    let parts = suffixes.iter().zip(sections);
    let mut messages = parts
        .map(|(suffix, lines)| {
            let name = name.suffixed(suffix).map_err(in_first_line)?;
            parse::message(name, lines.into_iter())
        })
        .collect::<Result<Vec<_>, _>>()?;
    let derived = match name.kind() {
        Kind::Msg => Ok(()),
        Kind::Srv => service(&mut messages, name),
        Kind::Action => action(&mut messages, name),
    };
    derived.map_err(in_first_line)?;
    Ok(messages)
}

/// The error of a derived type, whose name may be too long. No line of the text is wrong.
fn in_first_line(error: NameError) -> DefinitionError {
    DefinitionError {
        line: 1,
        reason: error.into(),
    }
}

/// Adds the event and the service itself, which have no definition of their own.
fn service(messages: &mut Vec<Message>, name: &TypeName) -> Result<(), NameError> {
    let part = |suffix| name.suffixed(suffix).map(Base::Message);
    let info = TypeName::new("service_msgs", Kind::Msg, "ServiceEventInfo")?;
    let at_most_one = Shape::Sequence(Some(1));
    let event = [
        field("info", Base::Message(info), Shape::One),
        field("request", part("_Request")?, at_most_one),
        field("response", part("_Response")?, at_most_one),
    ];
    messages.push(derived(name.suffixed("_Event")?, event));
    let whole = [
        field("request_message", part("_Request")?, Shape::One),
        field("response_message", part("_Response")?, Shape::One),
        field("event_message", part("_Event")?, Shape::One),
    ];
    messages.push(derived(name.clone(), whole));
    Ok(())
}

fn action(messages: &mut Vec<Message>, name: &TypeName) -> Result<(), NameError> {
    let one = |label, base| field(label, base, Shape::One);
    let part = |suffix| name.suffixed(suffix).map(Base::Message);
    let uuid = TypeName::new("unique_identifier_msgs", Kind::Msg, "UUID")?;
    let stamp = TypeName::new("builtin_interfaces", Kind::Msg, "Time")?;
    let goal_id = || one("goal_id", Base::Message(uuid.clone()));
    let fields = [
        (
            "_SendGoal_Request",
            vec![goal_id(), one("goal", part("_Goal")?)],
        ),
        (
            "_SendGoal_Response",
            vec![
                one("accepted", Base::Primitive(Primitive::Bool)),
                one("stamp", Base::Message(stamp)),
            ],
        ),
        ("_GetResult_Request", vec![goal_id()]),
        (
            "_GetResult_Response",
            vec![
                one("status", Base::Primitive(Primitive::Int8)),
                one("result", part("_Result")?),
            ],
        ),
        (
            "_FeedbackMessage",
            vec![goal_id(), one("feedback", part("_Feedback")?)],
        ),
    ];
    for (suffix, fields) in fields {
        messages.push(derived(name.suffixed(suffix)?, fields));
    }
    service(messages, &name.suffixed("_SendGoal")?)?;
    service(messages, &name.suffixed("_GetResult")?)?;
    let whole = [
        one("goal", part("_Goal")?),
        one("result", part("_Result")?),
        one("feedback", part("_Feedback")?),
        one("send_goal_service", part("_SendGoal")?),
        one("get_result_service", part("_GetResult")?),
        one("feedback_message", part("_FeedbackMessage")?),
    ];
    messages.push(derived(name.clone(), whole));
    Ok(())
}

fn derived(name: TypeName, fields: impl IntoIterator<Item = Field>) -> Message {
    Message {
        name,
        fields: fields.into_iter().collect(),
        constants: Vec::new(),
        comment: Box::default(),
    }
}

fn field(name: &str, base: Base, shape: Shape) -> Field {
    Field {
        name: name.into(),
        ty: FieldType { base, shape },
        default: None,
        comment: Box::default(),
    }
}
