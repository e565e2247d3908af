//! The first difference of two schemas, for a person who wants to know why two programs do not fit.

use std::fmt;

use sm2_proto::schema::{Definition, Encoding, Field, Root, Schema, Type};

/// The first place where two schemas differ.
///
/// `acceleration: array of 3 f64 here, array of 4 f64 there`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The fields that lead to this place, such as `points[].x`; empty for the message itself.
    pub path: String,
    /// The first schema's type, field or variant at this place.
    pub here: String,
    /// The second schema's type, field or variant at this place.
    pub there: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, here, there } = self;
        let path = if path.is_empty() { "message" } else { path };
        write!(f, "{path}: {here} here, {there} there")
    }
}

/// The first difference between two schemas, if they differ.
#[must_use]
pub fn difference(here: &Schema, there: &Schema) -> Option<Difference> {
    if here.encoding() != there.encoding() {
        let side = |it: &Encoding| format!("encoded as {}", it.name());
        return found("", side(here.encoding()), side(there.encoding()));
    }
    match (here.root(), there.root()) {
        (Root::Type(here), Root::Type(there)) => types("", here, there),
        (Root::Definition(here), Root::Definition(there)) => definitions(here, there),
        // The encodings differ: a definition has encoding `cdr`, and a type has another one.
        _ => None,
    }
}

/// The first line that differs, or else the hashes.
fn definitions(here: &Definition, there: &Definition) -> Option<Difference> {
    let mut lines = [here, there].map(|it| it.text().lines());
    // The name of the type that the lines belong to.
    let mut path = "";
    loop {
        match lines.each_mut().map(Iterator::next) {
            [None, None] => break,
            [Some(here), Some(there)] if here == there => {
                path = here.strip_prefix("MSG: ").unwrap_or(path);
            }
            sides => return found(&shown(path), side(sides[0]), side(sides[1])),
        }
    }
    if here.rihs01() == there.rihs01() {
        return None;
    }
    // The first line of the text.
    let hash = |it: &Definition| it.to_string().lines().next().unwrap_or_default().to_owned();
    found("", hash(here), hash(there))
}

/// One side of a difference: a line that a program prints, or the end of the definition.
fn side(line: Option<&str>) -> String {
    line.map_or_else(
        || "no more lines".into(),
        |line| format!("`{}`", shown(line)),
    )
}

fn shown(text: &str) -> String {
    format!("{}", text.escape_debug())
}

fn types(path: &str, here: &Type, there: &Type) -> Option<Difference> {
    match (here, there) {
        (Type::Struct(here), Type::Struct(there)) => fields(path, here, there),
        (Type::Enum(here), Type::Enum(there)) => members(
            path,
            ("variant", "variants"),
            (here.len(), there.len()),
            |at| {
                [
                    here.get(at).map(|it| it.name()),
                    there.get(at).map(|it| it.name()),
                ]
            },
            |path, at| fields(path, here[at].fields(), there[at].fields()),
        ),
        (
            Type::Array { element: here, len },
            Type::Array {
                element: there,
                len: other,
            },
        ) if len == other => types(&format!("{path}[]"), here, there),
        (Type::List(here), Type::List(there)) | (Type::Set(here), Type::Set(there)) => {
            types(&format!("{path}[]"), here, there)
        }
        (
            Type::Map { key, value },
            Type::Map {
                key: other_key,
                value: other_value,
            },
        ) => types(&format!("{path}[key]"), key, other_key)
            .or_else(|| types(&format!("{path}[]"), value, other_value)),
        (Type::Option(here), Type::Option(there)) => types(path, here, there),
        _ if here == there => None,
        _ => found(path, brief(here), brief(there)),
    }
}

fn fields(path: &str, here: &[Field], there: &[Field]) -> Option<Difference> {
    members(
        path,
        ("field", "fields"),
        (here.len(), there.len()),
        |at| {
            [
                here.get(at).map(|it| it.name()),
                there.get(at).map(|it| it.name()),
            ]
        },
        |path, at| types(path, here[at].ty(), there[at].ty()),
    )
}

/// Compares the named members of two types: the first name that differs, or else the first
/// difference within a member.
fn members<'a>(
    path: &str,
    (one, many): (&str, &str),
    (here, there): (usize, usize),
    names: impl Fn(usize) -> [Option<&'a str>; 2],
    content: impl Fn(&str, usize) -> Option<Difference>,
) -> Option<Difference> {
    for at in 0..here.max(there) {
        let side = |name: Option<&str>, len: usize| match name {
            Some(name) => format!("{one} {}", name.escape_debug()),
            None if len == 0 => format!("no {many}"),
            None => format!("no more than {len} {}", if len == 1 { one } else { many }),
        };
        match names(at) {
            [Some(name), Some(other)] if name == other => {
                let name = name.escape_debug();
                let path = match path {
                    "" => format!("{name}"),
                    _ => format!("{path}.{name}"),
                };
                if let Some(found) = content(&path, at) {
                    return Some(found);
                }
            }
            [name, other] => return found(path, side(name, here), side(other, there)),
        }
    }
    None
}

fn found(path: &str, here: String, there: String) -> Option<Difference> {
    let path = path.into();
    Some(Difference { path, here, there })
}

/// A short description of a type, however large the type is.
fn brief(ty: &Type) -> String {
    let count = |len: usize, what: &str| format!("{len} {what}{}", if len == 1 { "" } else { "s" });
    match ty {
        Type::Scalar(scalar) => scalar.name().into(),
        Type::Text => "string".into(),
        Type::Struct(fields) => format!("structure of {}", count(fields.len(), "field")),
        Type::Enum(variants) => format!("enumeration of {}", count(variants.len(), "variant")),
        Type::Array { element, len } => format!("array of {len} {}", brief(element)),
        Type::List(element) => format!("list of {}", brief(element)),
        Type::Set(element) => format!("set of {}", brief(element)),
        Type::Map { key, value } => format!("map from {} to {}", brief(key), brief(value)),
        Type::Option(value) => format!("optional {}", brief(value)),
    }
}
