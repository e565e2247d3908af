//! Citations: the lines of code and the fields of vectors that name clauses.

use std::path::Path;

use super::walk::Syntax;
use super::{CheckKind, ClauseId, Gap, GapKind, Role, SourceLine};

/// A citation of one clause on one line.
pub(super) struct Citation {
    pub(super) id: ClauseId,
    pub(super) role: Role,
    pub(super) at: SourceLine,
}

/// The macros that take an id as a literal.
const MACROS: [&str; 2] = ["clause!(", "violation!("];

/// Finds the ids in the arguments of [`MACROS`]. The compiler rejects a literal that is not an id.
pub(super) fn scan_macros(text: &str, file: &Path) -> Vec<Citation> {
    let calls = MACROS.iter().flat_map(|name| text.match_indices(name));
    let named = calls.filter_map(|(at, name)| {
        let arguments = text[at + name.len()..].split(')').next()?;
        let (before, literal) = arguments.split_once('"')?;
        // A call in a text, as in a test of this check, has its quotes escaped.
        let is_text = before.ends_with('\\');
        let (id, _) = ClauseId::parse_prefix(literal).filter(|_| !is_text)?;
        let at = SourceLine {
            file: file.to_owned(),
            line: 1 + text[..at].matches('\n').count(),
        };
        let role = Role::Name;
        Some(Citation { id, role, at })
    });
    named.collect()
}

/// Finds the citations in `text`, and the lines that resemble a citation but are malformed.
pub(super) fn scan(text: &str, syntax: Syntax, file: &Path) -> (Vec<Citation>, Vec<Gap>) {
    let mut citations = Vec::new();
    let mut gaps = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let found = match syntax {
            Syntax::Comments(marker) => read_comment(line, marker),
            Syntax::Vectors => read_fields(line),
        };
        let at = SourceLine {
            file: file.to_owned(),
            line: index + 1,
        };
        match found {
            Found::Nothing => {}
            Found::Unreadable => {
                let text = line.trim().to_owned();
                gaps.push(Gap::new(at, GapKind::UnreadableCitation { text }));
            }
            Found::Ids(ids, role) => citations.extend(ids.into_iter().map(|id| Citation {
                id,
                role,
                at: at.clone(),
            })),
        }
    }
    (citations, gaps)
}

enum Found {
    Nothing,
    Ids(Vec<ClauseId>, Role),
    Unreadable,
}

/// A line that is the marker, ids and perhaps a kind, and nothing else.
///
/// Reads a line that starts with the marker as a citation, unless another `=` follows: such a line is
/// a ruler.
fn read_comment(line: &str, marker: &str) -> Found {
    match line.trim().strip_prefix(marker) {
        Some(rest) if !rest.starts_with('=') => {
            read_ids(rest).map_or(Found::Unreadable, |(ids, role)| Found::Ids(ids, role))
        }
        _ => Found::Nothing,
    }
}

fn read_ids(text: &str) -> Option<(Vec<ClauseId>, Role)> {
    let mut ids = Vec::new();
    let mut rest = text;
    loop {
        let (id, after) = ClauseId::parse_prefix(rest.trim_start())?;
        ids.push(id);
        match after.trim_start().strip_prefix(',') {
            Some(more) => rest = more,
            None => return Some((ids, read_role(after)?)),
        }
    }
}

fn read_role(after_ids: &str) -> Option<Role> {
    if after_ids.is_empty() {
        return Some(Role::Code);
    }
    let word = after_ids.strip_prefix(char::is_whitespace)?.trim();
    let kind = CheckKind::ALL
        .into_iter()
        .find(|kind| kind.word() == word)?;
    Some(Role::Check(kind))
}

/// The fields `"clause": "SM2-XXX-000"` of one line of JSON. `null` says that
/// the vector checks no clause in particular.
///
/// A quote before the name may not be escaped: then it is text, not a field.
fn read_fields(line: &str) -> Found {
    const FIELD: &str = "\"clause\"";
    let mut ids = Vec::new();
    for (at, _) in line.match_indices(FIELD) {
        if line[..at].ends_with('\\') {
            continue;
        }
        let value = line[at + FIELD.len()..].trim_start().strip_prefix(':');
        let value = value.map_or("", str::trim_start);
        if value.starts_with("null") {
            continue;
        }
        let id = value.strip_prefix('"').and_then(ClauseId::parse_prefix);
        match id {
            Some((id, rest)) if rest.starts_with('"') => ids.push(id),
            _ => return Found::Unreadable,
        }
    }
    if ids.is_empty() {
        return Found::Nothing;
    }
    Found::Ids(ids, Role::Check(CheckKind::Vector))
}
