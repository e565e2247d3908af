//! The clauses of SPEC.md and their levels.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt;
use std::path::Path;

use super::{ClauseId, Gap, GapKind, SourceLine};

/// The level of a clause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// In force: code and a check must cite it.
    Must,
    /// In force; may be left undone for a stated reason.
    Should,
    /// In force; a permission.
    May,
    /// Designed, not yet in force: nothing may cite it.
    Draft,
    /// Withdrawn; its id is never used again and nothing may cite it.
    Retired,
}

impl Level {
    /// Every level, the most binding first.
    pub const ALL: [Self; 5] = [
        Self::Must,
        Self::Should,
        Self::May,
        Self::Draft,
        Self::Retired,
    ];

    /// The word in brackets in SPEC.md.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Must => "MUST",
            Self::Should => "SHOULD",
            Self::May => "MAY",
            Self::Draft => "DRAFT",
            Self::Retired => "RETIRED",
        }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// One clause line.
pub(super) struct Clause {
    pub(super) level: Level,
    pub(super) at: SourceLine,
}

/// All clause lines, retired ones included.
pub(super) struct Spec {
    pub(super) clauses: BTreeMap<ClauseId, Clause>,
}

/// Reads the clause lines of `text`, and returns the gaps of this text.
pub(super) fn parse(text: &str, file: &Path) -> (Spec, Vec<Gap>) {
    let mut clauses = BTreeMap::new();
    let mut gaps = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let at = SourceLine {
            file: file.to_owned(),
            line: index + 1,
        };
        match read_line(line) {
            Line::Text => {}
            Line::Malformed => gaps.push(Gap::new(at, GapKind::MalformedClause)),
            Line::Clause(id, level) => match clauses.entry(id) {
                Entry::Vacant(slot) => {
                    slot.insert(Clause { level, at });
                }
                Entry::Occupied(slot) => {
                    let first = slot.get().at.clone();
                    gaps.push(Gap::new(at, GapKind::DuplicateId { id, first }));
                }
            },
        }
    }
    gaps.extend(dangling(text, file, &clauses));
    (Spec { clauses }, gaps)
}

enum Line {
    Text,
    Clause(ClauseId, Level),
    Malformed,
}

fn read_line(line: &str) -> Line {
    let read = if line.starts_with("**SM2-") {
        read_in_force(line)
    } else if line.starts_with("~~SM2-") {
        read_retired(line)
    } else if is_misplaced(line) {
        None
    } else {
        return Line::Text;
    };
    read.map_or(Line::Malformed, |(id, level)| Line::Clause(id, level))
}

/// `**SM2-MGR-012** [MUST] text`
fn read_in_force(line: &str) -> Option<(ClauseId, Level)> {
    let (id, rest) = ClauseId::parse_prefix(line.strip_prefix("**")?)?;
    let (word, text) = rest.strip_prefix("** [")?.split_once("] ")?;
    let level = Level::ALL.into_iter().find(|level| level.word() == word)?;
    let in_force = level != Level::Retired && !text.trim().is_empty();
    in_force.then_some((id, level))
}

/// `~~SM2-MGR-012~~ [RETIRED]`, with or without a word on why.
fn read_retired(line: &str) -> Option<(ClauseId, Level)> {
    let (id, rest) = ClauseId::parse_prefix(line.strip_prefix("~~")?)?;
    let why = rest.strip_prefix("~~ [RETIRED]")?;
    let ends = why.is_empty() || why.starts_with(' ');
    ends.then_some((id, Level::Retired))
}

/// A clause inside a list, a quote or a sentence would not be read, so it is reported.
fn is_misplaced(line: &str) -> bool {
    ["**SM2-", "~~SM2-"].into_iter().any(|open| {
        line.match_indices(open).any(|(at, _)| {
            let rest = &line[at + open.len()..];
            rest.contains("** [") || rest.contains("~~ [")
        })
    })
}

/// Ids that the text mentions and that no clause line has.
fn dangling(text: &str, file: &Path, clauses: &BTreeMap<ClauseId, Clause>) -> Vec<Gap> {
    let mut gaps = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let mentioned = line
            .match_indices("SM2-")
            .filter_map(|(at, _)| ClauseId::parse_prefix(&line[at..]));
        for (id, _) in mentioned.filter(|(id, _)| !clauses.contains_key(id)) {
            let at = SourceLine {
                file: file.to_owned(),
                line: index + 1,
            };
            gaps.push(Gap::new(at, GapKind::DanglingReference { id }));
        }
    }
    gaps
}
