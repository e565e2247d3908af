//! Reads the prohibitions of SPEC.md, to compare the tables with them.

use std::{collections::BTreeSet, fs, path::PathBuf};

use sm2_proto::{Code, ViolationKind};

const SPEC: &str = include_str!("../../../SPEC.md");

/// One row of the table of codes in SPEC section 10.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The code.
    pub code: u16,
    /// Its name.
    pub name: String,
    /// The clauses and sections that the table names for it.
    pub clauses: BTreeSet<String>,
}

/// The violations of SPEC section 10: the codes from 16 on.
#[must_use]
pub fn entries() -> Vec<Entry> {
    let section = SPEC.split("\n## ").find(|it| it.starts_with("10. Codes"));
    let section = section.expect("section 10");
    let rows = section.lines().filter(|line| line.starts_with("| "));
    let entries = rows.filter_map(|line| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let code = cells.get(1)?.parse().ok()?;
        let clauses = cells.get(3)?.split(", ").filter(|cell| is_reference(cell));
        Some(Entry {
            code,
            name: cells.get(2)?.trim_matches('`').to_owned(),
            clauses: clauses.map(str::to_owned).collect(),
        })
    });
    entries.filter(|entry| entry.code >= 16).collect()
}

fn is_reference(cell: &str) -> bool {
    cell.starts_with("SM2-") || cell.starts_with("section ")
}

/// The text of a clause or of a section.
#[must_use]
pub fn text_of(reference: &str) -> Option<&'static str> {
    if let Some(number) = reference.strip_prefix("section ") {
        let start = SPEC.find(&format!("# {number} "))?;
        let section = &SPEC[start..];
        let end = section[1..]
            .find("\n#")
            .map_or(section.len(), |end| end + 1);
        return Some(&section[..end]);
    }
    let head = format!("**{reference}**");
    SPEC.lines().find(|line| line.starts_with(&head))
}

/// True if the clause, or its table of codes, names this violation.
#[must_use]
pub fn names(reference: &str, violation: ViolationKind) -> bool {
    let name = format!("`{}`", violation.name());
    let text = text_of(reference).unwrap_or_default();
    let listed =
        |entry: &Entry| entry.code == violation.code().0 && entry.clauses.contains(reference);
    text.contains(&name) || entries().iter().any(listed)
}

/// The kinds of violations with the clauses that the sources of `sm2-proto` name for them.
///
/// # Panics
/// A file cannot be read.
#[must_use]
pub fn named_in_sources() -> Vec<(String, String)> {
    let mut named = Vec::new();
    let mut folders = vec![concat!(env!("CARGO_MANIFEST_DIR"), "/../sm2-proto/src").into()];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir::<PathBuf>(folder).expect("a folder");
        for path in entries.map(|entry| entry.expect("an entry").path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|it| it == "rs") {
                named.extend(named_in(&fs::read_to_string(&path).expect("a file")));
            }
        }
    }
    named
}

/// The arguments of each `violation!` whose kind is one of [`ViolationKind`].
fn named_in(text: &str) -> impl Iterator<Item = (String, String)> + use<'_> {
    let calls = text.split("violation!(").skip(1);
    calls.filter_map(|call| {
        let (kind, clause) = call.split(')').next()?.split_once(',')?;
        let clause = clause.trim().strip_prefix('"')?.split('"').next()?;
        let is_ours = !kind.contains(['$', ':']);
        is_ours.then(|| (kind.trim().to_owned(), clause.to_owned()))
    })
}

/// The violation of an entry.
#[must_use]
pub fn violation(entry: &Entry) -> Option<ViolationKind> {
    ViolationKind::from_code(Code(entry.code)).filter(|violation| violation.name() == entry.name)
}
