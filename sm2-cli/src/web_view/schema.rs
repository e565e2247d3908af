//! The schema of a topic or service, for the page.

use sm2_proto::Name;

use crate::{
    connect::CommandNode,
    error::CliError,
    interfaces::StatedType,
    view::{SERVICE, TOPIC, View},
};

/// The types of a topic or service, each with its schema text.
///
/// # Errors
///
/// As [`CommandNode::describe`].
pub(super) fn lines(
    command_node: &CommandNode,
    view: &View<'_>,
    name: &Name,
) -> Result<Vec<String>, CliError> {
    let of_topic = view.topic_type(name).map(|data| ("type", data));
    let [request, reply] = match view.service_types(name) {
        Some([request, reply]) => [Some(("request", request)), Some(("reply", reply))],
        None => [None, None],
    };
    let mut lines = Vec::new();
    for (role, data) in [of_topic, request, reply].into_iter().flatten() {
        let [_, schema] = StatedType::of(command_node, Some(data))?.texts();
        lines.push(format!("{role} {}", data.name));
        lines.extend(broken(&schema));
    }
    if lines.is_empty() {
        let is_known = [TOPIC, SERVICE].map(|kinds| view.names(kinds).contains(name));
        lines.push(match is_known {
            [false, false] => format!("nothing has the name {name} any more"),
            _ => "no interface has stated a type".to_owned(),
        });
    }
    Ok(lines)
}

/// A schema text with one member on each line. A definition of ROS 2 has lines already.
fn broken(text: &str) -> Vec<String> {
    if text.contains('\n') {
        return text.lines().map(str::to_owned).collect();
    }
    let (mut lines, mut line, mut depth) = (Vec::new(), String::new(), 0_usize);
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        if c == '}' {
            depth = depth.saturating_sub(1);
        }
        if line.is_empty() {
            line = "  ".repeat(depth);
        }
        line.push(c);
        let opens = c == '{' && rest.peek() != Some(&'}');
        depth += usize::from(c == '{');
        if opens || c == ',' {
            lines.push(std::mem::take(&mut line));
        }
    }
    if !line.is_empty() {
        lines.push(line);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_member_has_a_line() {
        let text = "postcard:struct{mode:enum{Idle:struct{},Go:struct{0:u8,},},rate:option[f64],}";
        let expected = [
            "postcard:struct{",
            "  mode:enum{",
            "    Idle:struct{},",
            "    Go:struct{",
            "      0:u8,",
            "    },",
            "  },",
            "  rate:option[f64],",
            "}",
        ];
        assert_eq!(broken(text), expected);
        assert_eq!(broken(text).concat().replace(' ', ""), text);
        assert_eq!(broken("plain:u8"), ["plain:u8"]);
        assert_eq!(broken("uint8 a\nuint8 b\n"), ["uint8 a", "uint8 b"]);
    }
}
