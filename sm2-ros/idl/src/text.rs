//! The text of a type with all types that it refers to: MCAP's schema encoding `ros2msg`.

use std::fmt::Write as _;

use crate::{DefinitionError, Message, Reason, Set, SetError, TypeName, parse};

/// The line between two definitions.
const SEPARATOR: &str =
    "================================================================================";

impl Set {
    /// Writes a type and the types that it refers to, without comments, so that equal definitions have equal
    /// texts.
    ///
    /// # Errors
    ///
    /// As [`closure`](Self::closure).
    pub fn text(&self, name: &TypeName) -> Result<String, SetError> {
        let mut types = self.closure(name)?;
        let mut text = String::new();
        if let Some(whole) = types.pop() {
            write(&mut text, whole);
        }
        types.sort_by_key(|it| &it.name);
        for part in types {
            let base = crate::Base::Message(part.name.clone());
            // Writing to a `String` does not fail.
            let _never = writeln!(text, "{SEPARATOR}\nMSG: {base}");
            write(&mut text, part);
        }
        Ok(text)
    }

    /// Writes the schema text of a type in SM2's encoding `cdr` (SPEC Annex A): the RIHS01 hash, and the
    /// [text](Self::text).
    ///
    /// # Errors
    ///
    /// As [`closure`](Self::closure).
    pub fn schema_text(&self, name: &TypeName) -> Result<String, SetError> {
        let (hash, text) = (self.hash(name)?, self.text(name)?);
        Ok(format!("cdr:{hash}\n{text}"))
    }

    /// Reads the [text](Self::text) of a type, from any program. The first definition is that of `name`.
    ///
    /// # Errors
    ///
    /// [`DefinitionError`] with the line that is wrong.
    pub fn parse(name: &TypeName, text: &str) -> Result<Self, DefinitionError> {
        let mut set = Self::default();
        let mut lines = text.lines().enumerate().map(|(at, line)| (at + 1, line));
        let mut next = Some(name.clone());
        while let Some(name) = next.take() {
            let mut separator = None;
            let section = lines.by_ref().take_while(|(at, line)| {
                let is_separator = line.len() >= 3 && line.trim_end().bytes().all(|b| b == b'=');
                separator = is_separator.then_some(*at);
                !is_separator
            });
            set.insert(parse::message(name, section)?);
            let Some(line) = separator else { break };
            let header = lines.next().and_then(|(_, line)| line.strip_prefix("MSG:"));
            let wrong = |reason| DefinitionError {
                line: line + 1,
                reason,
            };
            let header = header.ok_or_else(|| wrong(Reason::Header))?;
            let name = TypeName::referred(header.trim(), "");
            next = Some(name.map_err(|error| wrong(error.into()))?);
        }
        Ok(set)
    }
}

fn write(text: &mut String, message: &Message) {
    for constant in &message.constants {
        let (ty, name, value) = (&constant.ty, &constant.name, &constant.value);
        let _never = writeln!(text, "{ty} {name}={value}");
    }
    for field in &message.fields {
        let _never = match &field.default {
            Some(default) => writeln!(text, "{} {} {default}", field.ty, field.name),
            None => writeln!(text, "{} {}", field.ty, field.name),
        };
    }
}
