//! Messages without a schema: text as it is, anything else as its first bytes in hex.

use std::fmt;

use sm2_proto::text::Counted;

/// The number of bytes that are shown of a message that is not text.
const HEAD_BYTES: usize = 32;

/// The message as text, if it can be printed safely: UTF-8 whose only control characters are newline and tab.
pub(crate) fn as_text(message: &[u8]) -> Option<&str> {
    let text = str::from_utf8(message).ok()?;
    let plain = |c: char| !c.is_control() || matches!(c, '\n' | '\t');
    text.chars().all(plain).then_some(text)
}

/// Appends the message on lines of its own: its text, or its length and first bytes.
pub(crate) fn write_message(out: &mut Vec<u8>, message: &[u8]) {
    match as_text(message) {
        Some(text) => {
            out.extend_from_slice(text.as_bytes());
            if !text.ends_with('\n') {
                out.push(b'\n');
            }
        }
        None => {
            write_bytes(out, message);
            out.push(b'\n');
        }
    }
}

/// Appends the message's length and first bytes, without a newline.
pub(crate) fn write_bytes(out: &mut Vec<u8>, message: &[u8]) {
    let head = &message[..message.len().min(HEAD_BYTES)];
    let more = match head.len() < message.len() {
        true => " …",
        false => "",
    };
    let line = format!(
        "{}: {}{more}",
        Counted::new(message.len() as u64, "byte"),
        Hex(head, " ")
    );
    out.extend_from_slice(line.as_bytes());
}

/// A text on one line, with control characters escaped. The text may come from another program.
pub(crate) fn one_line(text: &str) -> String {
    escaped(text, char::is_control, char::escape_default)
}

/// A text with escapes in the place of some characters.
pub(crate) fn escaped<E: fmt::Display>(
    text: &str,
    is_escaped: impl Fn(char) -> bool,
    escape: impl Fn(char) -> E,
) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match is_escaped(c) {
            true => out += &escape(c).to_string(),
            false => out.push(c),
        }
    }
    out
}

/// Bytes as two hex digits each, with a separator between them.
pub(crate) struct Hex<'a>(pub(crate) &'a [u8], pub(crate) &'a str);

impl fmt::Display for Hex<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, byte) in self.0.iter().enumerate() {
            let separator = if at == 0 { "" } else { self.1 };
            write!(f, "{separator}{byte:02x}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
