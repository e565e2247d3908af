//! The comments of a definition, and the fields and constants that they describe.

use sm2_ros_idl::{Message, Set, TypeName};

fn message(text: &str) -> Message {
    let mut set = Set::default();
    let name: TypeName = "p/msg/T".parse().unwrap();
    set.add(&name, text).unwrap();
    set.get(&name).unwrap().clone()
}

/// The comments of the message and of its fields.
fn comments(text: &str) -> Vec<String> {
    let message = message(text);
    let fields = message.fields.iter().map(|it| &it.comment);
    let all = std::iter::once(&message.comment).chain(fields);
    all.map(ToString::to_string).collect()
}

#[test]
fn comments_belong_to_what_they_describe() {
    let text = "\
# A wheel.
#   It turns.

# Where it is.
uint8 LEFT=0   # on the left
uint8 RIGHT=1

# Radians per second,
# forwards.

float64 speed  # measured
               # each time
string name \"#1\"
# The end.
";
    let message = message(text);
    assert_eq!(&*message.comment, "A wheel.\n  It turns.");
    let constants = message.constants.iter().map(|it| &*it.comment);
    assert_eq!(
        constants.collect::<Vec<_>>(),
        ["Where it is.\non the left", ""]
    );
    let fields = message.fields.iter().map(|it| &*it.comment);
    let speed = "Radians per second,\nforwards.\n\nmeasured\neach time";
    assert_eq!(fields.collect::<Vec<_>>(), [speed, ""]);
}

#[test]
fn the_first_block_before_an_empty_line_describes_the_message() {
    let text = "# All.\n\n# One.\n\nint8 a\n# Two.\n\nint8 b\n";
    assert_eq!(comments(text), ["All.", "One.", "Two."]);
    // Without an empty line, the block describes the field.
    assert_eq!(comments("# One.\nint8 a\n"), ["", "One."]);
    // A block behind the first field describes the next one.
    let text = "int8 a\n# Two.\n\nint8 b\n";
    assert_eq!(comments(text), ["", "", "Two."]);
}

#[test]
fn only_indented_lines_continue_the_comment_behind_a_field() {
    for (text, expected) in [
        ("int8 a # x\n       # y\nint8 b\n", ["", "x\ny", ""]),
        ("int8 a # x\n\t# y\nint8 b\n", ["", "x\ny", ""]),
        ("int8 a # x\n# y\nint8 b\n", ["", "x", "y"]),
        // An empty line between them changes nothing.
        ("int8 a # x\n\n       # y\nint8 b\n", ["", "x\ny", ""]),
        // A field without a comment has none to continue.
        ("int8 a\n       # y\nint8 b\n", ["", "", "y"]),
        // The comment of the next field has begun.
        ("int8 a # x\n# y\n  # z\nint8 b\n", ["", "x", "y\nz"]),
    ] {
        assert_eq!(comments(text), expected, "{text:?}");
    }
}

#[test]
fn the_signs_of_a_comment_are_not_part_of_it() {
    let text = "## One.  \nint8 a #two\nint8 b #   three\n";
    assert_eq!(comments(text), ["", "One.\ntwo", "  three"]);
}
