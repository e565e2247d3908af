//! Reads the lines of a definition.

use std::collections::BTreeSet;

use crate::comment::Comments;
use crate::{Base, Constant, DefinitionError, Field, FieldType, Message, Primitive, Reason};
use crate::{Shape, TypeName};

/// Reads the fields and constants of one message. `lines` have their numbers in the file, for errors.
pub(crate) fn message<'a>(
    name: TypeName,
    lines: impl Iterator<Item = (usize, &'a str)>,
) -> Result<Message, DefinitionError> {
    let mut message = Message {
        name,
        fields: Vec::new(),
        constants: Vec::new(),
        comment: Box::default(),
    };
    let mut names = BTreeSet::new();
    let mut comments = Comments::default();
    for (line, text) in lines {
        let (text, comment) = split_comment(text);
        let is_indented = text.starts_with([' ', '\t']);
        let text = text.trim();
        if text.is_empty() || text.starts_with('@') {
            comments.line(&mut message, comment, is_indented);
            continue;
        }
        comments.end_member(&mut message);
        let name = member(&mut message, text).map_err(|reason| DefinitionError { line, reason })?;
        if !names.insert(name) {
            let reason = Reason::NameTwice(name.to_owned());
            return Err(DefinitionError { line, reason });
        }
        comments.begin_member(comment);
    }
    comments.end_member(&mut message);
    Ok(message)
}

/// Adds the field or constant of one line. Returns its name.
fn member<'a>(message: &mut Message, text: &'a str) -> Result<&'a str, Reason> {
    let (ty, rest) = text
        .split_once(|c: char| c.is_ascii_whitespace())
        .ok_or(Reason::Name)?;
    let ty = field_type(ty, message.name.package())?;
    let rest = rest.trim_start();
    let end = rest
        .find(|c: char| c.is_ascii_whitespace() || c == '=')
        .unwrap_or(rest.len());
    let (name, value) = (&rest[..end], rest[end..].trim());
    if !is_member_name(name) {
        return Err(Reason::IllegalName(name.to_owned()));
    }
    match value.strip_prefix('=') {
        Some(value) => message.constants.push(Constant {
            name: name.into(),
            ty: constant_type(ty)?,
            value: match value.trim() {
                "" => return Err(Reason::ConstantValue),
                value => value.into(),
            },
            comment: Box::default(),
        }),
        None => message.fields.push(Field {
            name: name.into(),
            ty,
            default: (!value.is_empty()).then(|| value.into()),
            comment: Box::default(),
        }),
    }
    Ok(name)
}

fn constant_type(ty: FieldType) -> Result<Base, Reason> {
    match (ty.shape, ty.base) {
        (Shape::One, base @ (Base::Primitive(_) | Base::String { .. } | Base::WString { .. })) => {
            Ok(base)
        }
        _ => Err(Reason::ConstantType),
    }
}

fn field_type(text: &str, package: &str) -> Result<FieldType, Reason> {
    let (base, shape) = match text.strip_suffix(']').and_then(|it| it.rsplit_once('[')) {
        None => (text, Shape::One),
        Some((base, "")) => (base, Shape::Sequence(None)),
        Some((base, len)) => match len.strip_prefix("<=") {
            Some(max) => (base, Shape::Sequence(Some(limit(max)?))),
            None => (base, Shape::Array(limit(len)?)),
        },
    };
    let base = self::base(base, package)?;
    Ok(FieldType { base, shape })
}

fn base(text: &str, package: &str) -> Result<Base, Reason> {
    if let Some(primitive) = Primitive::ALL.iter().find(|it| it.name() == text) {
        return Ok(Base::Primitive(*primitive));
    }
    let (word, max) = match text.split_once("<=") {
        Some((word, max)) => (word, Some(limit(max)?)),
        None => (text, None),
    };
    match word {
        "string" => Ok(Base::String { max_bytes: max }),
        "wstring" => Ok(Base::WString { max_units: max }),
        _ => Ok(Base::Message(TypeName::referred(text, package)?)),
    }
}

fn limit(text: &str) -> Result<u32, Reason> {
    match text.parse() {
        Ok(limit) if limit > 0 => Ok(limit),
        _ => Err(Reason::Limit(text.to_owned())),
    }
}

fn is_member_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// The line up to a `#` that is not inside quotes, and the comment behind it, if there is one.
fn split_comment(line: &str) -> (&str, Option<&str>) {
    let mut quote = None;
    let mut escaped = false;
    for (at, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') => return (&line[..at], Some(&line[at..])),
            (None, '"' | '\'') => quote = Some(c),
            (Some(_), '\\') if !escaped => {
                escaped = true;
                continue;
            }
            (Some(open), _) if c == open && !escaped => quote = None,
            _ => {}
        }
        escaped = false;
    }
    // An apostrophe in a value without quotes opens nothing.
    match line.split_once('#').filter(|_| quote.is_some()) {
        Some((text, comment)) => (text, Some(comment)),
        None => (line, None),
    }
}
