//! The comments of a definition, and the fields and constants that they describe.
//!
//! | comment | describes |
//! | --- | --- |
//! | at the start, before an empty line | the message |
//! | lines above a field or constant | this field or constant |
//! | behind a field or constant, and indented lines below it | this field or constant |

use crate::Message;

/// The comments of one message, in the order of its lines.
#[derive(Debug, Default)]
pub(crate) struct Comments<'a> {
    /// The lines since the last field or constant, for the next one.
    above: Vec<&'a str>,
    /// The lines of the last field or constant.
    last: Vec<&'a str>,
    /// The number of constants before the last field or constant; `None` if there is none yet.
    constants: Option<usize>,
}

impl<'a> Comments<'a> {
    /// Takes a line without a field or constant.
    pub(crate) fn line(
        &mut self,
        message: &mut Message,
        comment: Option<&'a str>,
        is_indented: bool,
    ) {
        match comment {
            Some(comment) if is_indented && self.above.is_empty() && !self.last.is_empty() => {
                self.last.push(trimmed(comment));
            }
            Some(comment) => self.above.push(trimmed(comment)),
            None if self.constants.is_none() && message.comment.is_empty() => {
                message.comment = joined(&mut self.above);
            }
            None if self.above.is_empty() => {}
            None => self.above.push(""),
        }
    }

    /// Takes the comment behind a field or constant.
    pub(crate) fn begin_member(&mut self, comment: Option<&'a str>) {
        self.last = std::mem::take(&mut self.above);
        self.last.extend(comment.map(trimmed));
    }

    /// Gives the last field or constant of the message its comment. The next one follows.
    pub(crate) fn end_member(&mut self, message: &mut Message) {
        let comment = joined(&mut self.last);
        let before = self.constants.replace(message.constants.len());
        let is_constant = before.is_some_and(|it| it < message.constants.len());
        let place = match is_constant {
            true => message.constants.last_mut().map(|it| &mut it.comment),
            false => message.fields.last_mut().map(|it| &mut it.comment),
        };
        if let Some(place) = place {
            *place = comment;
        }
    }
}

fn trimmed(comment: &str) -> &str {
    let comment = comment.trim_start_matches('#').trim_end();
    comment.strip_prefix(' ').unwrap_or(comment)
}

/// The lines without empty ones at the start and at the end. None is left.
fn joined(lines: &mut Vec<&str>) -> Box<str> {
    let text = lines.join("\n");
    lines.clear();
    text.trim_matches('\n').into()
}
