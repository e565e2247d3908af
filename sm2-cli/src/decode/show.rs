//! The text of a decoded message for a terminal.

use std::fmt::{self, Write};

use sm2_ros::value::{Value, more};

/// The limits of the text.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Elements of each list, set and map.
    pub(crate) elements: usize,
    /// Characters of each text.
    pub(crate) characters: usize,
    /// A value that takes more bytes than this is broken into several lines.
    pub(crate) width: usize,
    /// Bytes of the whole message.
    pub(crate) total_bytes: usize,
}

impl Limits {
    /// Limits for messages that scroll by on a screen.
    pub(crate) const SCREEN: Self = Self {
        elements: 32,
        characters: 1_000,
        width: 80,
        total_bytes: 16_384,
    };
}

/// The text of a message, without a newline at the end. Fields are on separate lines if one line is not wide
/// enough. The text has no control characters that affect the terminal.
pub(crate) fn show(value: &Value<'_>, limits: &Limits) -> String {
    let mut out = Bounded {
        text: String::new(),
        room: limits.total_bytes,
    };
    let printer = Printer { limits };
    if printer.lines(&mut out, value, 0).is_err() {
        out.text.push_str(" … (cut here)");
    }
    out.text
}

/// A text of at most `room` more bytes. Writing more fails.
struct Bounded {
    text: String,
    room: usize,
}

impl Write for Bounded {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        match self.room.checked_sub(text.len()) {
            Some(room) => {
                self.room = room;
                self.text.push_str(text);
                Ok(())
            }
            None => {
                let fits = |(end, c): (usize, char)| end + c.len_utf8() <= self.room;
                let kept = text.char_indices().take_while(|it| fits(*it));
                self.text.extend(kept.map(|(_, c)| c));
                self.room = 0;
                Err(fmt::Error)
            }
        }
    }
}

struct Printer<'a> {
    limits: &'a Limits,
}

impl Printer<'_> {
    /// Writes the value on one line if it fits; else each field and element on its own line.
    fn lines(&self, out: &mut Bounded, value: &Value<'_>, indent: usize) -> fmt::Result {
        if let Some(line) = self.fitting(value, indent) {
            return out.write_str(&line);
        }
        match value {
            Value::Struct(fields) => self.entries(
                out,
                indent,
                fields
                    .iter()
                    .map(|(name, value)| (name.escape_debug().to_string(), value)),
            ),
            Value::Map {
                entries,
                more: left,
            } => {
                let kept = entries.iter().take(self.limits.elements);
                let lines = kept.map(|(key, value)| (self.one_line(key), value));
                self.entries(out, indent, lines)?;
                self.elision(out, entries.len(), *left, &line_break(indent))
            }
            Value::List { items, more: left } if breaks(value) => {
                for (at, item) in items.iter().take(self.limits.elements).enumerate() {
                    if at > 0 {
                        out.write_str(&line_break(indent))?;
                    }
                    out.write_str("- ")?;
                    self.lines(out, item, indent + 2)?;
                }
                self.elision(out, items.len(), *left, &line_break(indent))
            }
            Value::Variant(name, fields) if breaks(fields) => {
                write!(out, "{}:{}", name.escape_debug(), line_break(indent + 2))?;
                self.lines(out, fields, indent + 2)
            }
            _ => self.line(out, value),
        }
    }

    /// Writes `name: value` lines. A value that needs several lines starts on the next line.
    fn entries<'v>(
        &self,
        out: &mut Bounded,
        indent: usize,
        entries: impl Iterator<Item = (String, &'v Value<'v>)>,
    ) -> fmt::Result {
        for (at, (name, value)) in entries.enumerate() {
            if at > 0 {
                out.write_str(&line_break(indent))?;
            }
            write!(out, "{name}:")?;
            let after = indent + name.chars().count() + 2;
            if breaks(value) && self.fitting(value, after).is_none() {
                out.write_str(&line_break(indent + 2))?;
                self.lines(out, value, indent + 2)?;
            } else {
                out.write_str(" ")?;
                self.line(out, value)?;
            }
        }
        Ok(())
    }

    /// The value on one line, if there is room for it after `indent` characters.
    fn fitting(&self, value: &Value<'_>, indent: usize) -> Option<String> {
        let width = self.limits.width.min(self.limits.total_bytes);
        let mut line = Bounded {
            text: String::new(),
            room: width.saturating_sub(indent),
        };
        self.line(&mut line, value).ok().map(|()| line.text)
    }

    fn one_line(&self, value: &Value<'_>) -> String {
        let mut line = Bounded {
            text: String::new(),
            room: self.limits.total_bytes,
        };
        // A key that does not fit is cut; the message is cut at the same place.
        let _cut = self.line(&mut line, value);
        line.text
    }

    fn line(&self, out: &mut Bounded, value: &Value<'_>) -> fmt::Result {
        match value {
            Value::Unit => out.write_str("()"),
            Value::Absent => out.write_str("null"),
            Value::Bool(value) => write!(out, "{value}"),
            Value::Unsigned(number) => write!(out, "{number}"),
            Value::Signed(number) => write!(out, "{number}"),
            Value::Digits(digits) => out.write_str(digits),
            Value::F32(number) => write!(out, "{number:?}"),
            Value::F64(number) => write!(out, "{number:?}"),
            Value::Char(c) => write!(out, "{c:?}"),
            Value::Text(text) => self.text(out, text),
            Value::List { items, more: left } => {
                out.write_str("[")?;
                for (at, item) in items.iter().take(self.limits.elements).enumerate() {
                    out.write_str(if at > 0 { ", " } else { "" })?;
                    self.line(out, item)?;
                }
                self.elision(out, items.len(), *left, ", ")?;
                out.write_str("]")
            }
            Value::Map {
                entries,
                more: left,
            } => {
                out.write_str("{")?;
                for (at, (key, value)) in entries.iter().take(self.limits.elements).enumerate() {
                    out.write_str(if at > 0 { ", " } else { "" })?;
                    self.line(out, key)?;
                    out.write_str(": ")?;
                    self.line(out, value)?;
                }
                self.elision(out, entries.len(), *left, ", ")?;
                out.write_str("}")
            }
            Value::Struct(fields) => {
                out.write_str("{")?;
                for (at, (name, value)) in fields.iter().enumerate() {
                    let separator = if at > 0 { ", " } else { "" };
                    write!(out, "{separator}{}: ", name.escape_debug())?;
                    self.line(out, value)?;
                }
                out.write_str("}")
            }
            Value::Variant(name, fields) => {
                write!(out, "{}", name.escape_debug())?;
                match **fields {
                    Value::Unit => Ok(()),
                    Value::Struct(_) | Value::List { .. } => {
                        out.write_str(" ")?;
                        self.line(out, fields)
                    }
                    _ => {
                        out.write_str("(")?;
                        self.line(out, fields)?;
                        out.write_str(")")
                    }
                }
            }
        }
    }

    /// Writes the number of elements that are not shown, kept or not, if there are any.
    fn elision(&self, out: &mut Bounded, kept: usize, left: u64, separator: &str) -> fmt::Result {
        let shown = kept.min(self.limits.elements);
        match (kept - shown) as u64 + left {
            0 => Ok(()),
            count if shown == 0 => out.write_str(&more(count)),
            count => write!(out, "{separator}{}", more(count)),
        }
    }

    fn text(&self, out: &mut Bounded, text: &str) -> fmt::Result {
        match text.char_indices().nth(self.limits.characters) {
            None => write!(out, "{text:?}"),
            Some((end, _)) => {
                let count = text[end..].chars().count() as u64;
                write!(out, "{:?} {}", &text[..end], more(count))
            }
        }
    }
}

/// Whether a value that is too long for a line is broken into several.
fn breaks(value: &Value<'_>) -> bool {
    match value {
        Value::Struct(_) | Value::Map { .. } => true,
        Value::List { items, .. } => !items.iter().all(is_small),
        Value::Variant(_, fields) => breaks(fields),
        _ => false,
    }
}

/// Whether a list shows such values side by side.
const fn is_small(value: &Value<'_>) -> bool {
    !matches!(
        value,
        Value::List { .. }
            | Value::Map { .. }
            | Value::Struct(_)
            | Value::Variant(..)
            | Value::Text(_)
    )
}

fn line_break(indent: usize) -> String {
    format!("\n{:indent$}", "")
}
