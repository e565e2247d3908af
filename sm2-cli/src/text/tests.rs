use super::*;

fn shown(message: &[u8]) -> String {
    let mut out = Vec::new();
    write_message(&mut out, message);
    String::from_utf8(out).unwrap()
}

#[test]
fn text_is_a_line_of_its_own() {
    assert_eq!(shown(b"hello"), "hello\n");
    assert_eq!(shown(b"hello\n"), "hello\n");
    assert_eq!(shown(b""), "\n");
    assert_eq!(shown("a\tb\nünï".as_bytes()), "a\tb\nünï\n");
}

#[test]
fn anything_else_is_its_length_and_head() {
    assert_eq!(shown(&[0, 255]), "2 bytes: 00 ff\n");
    assert_eq!(shown(b"\x1b[2J"), "4 bytes: 1b 5b 32 4a\n");
    assert_eq!(shown(b"a\rb"), "3 bytes: 61 0d 62\n");
    // A C1 control character, which some terminals interpret.
    assert_eq!(shown("\u{9b}".as_bytes()), "2 bytes: c2 9b\n");
    let head = ["07"; HEAD_BYTES].join(" ");
    assert_eq!(shown(&[7; 33]), format!("33 bytes: {head} …\n"));
    assert_eq!(shown(&[7; 32]), format!("32 bytes: {head}\n"));
}

#[test]
fn what_others_wrote_stays_on_its_line() {
    assert_eq!(one_line("grün: `a b`"), "grün: `a b`");
    let hostile = "no\n\x1b[2J\u{9b}2J";
    assert_eq!(one_line(hostile), "no\\n\\u{1b}[2J\\u{9b}2J");
}
