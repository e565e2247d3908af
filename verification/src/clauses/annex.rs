//! The procedures of Annex B speak of every frame, code and fate of the tables.

use std::path::Path;

use super::{Gap, GapKind, SourceLine};

/// The heading of the procedures.
const PROCEDURES: &str = "## Annex B.";
/// The ends of the headings whose tables list frames and codes.
const TABLES: [&str; 3] = [". Control frames", ". Link frames", ". Codes"];
/// The marks around the table of the fates of messages.
const FATES: [&str; 2] = ["<!-- ANCHOR: fates -->", "<!-- ANCHOR_END: fates -->"];

/// The names of the tables that the procedures do not mention. A text without procedures has no gaps.
pub(super) fn unmentioned(text: &str, file: &Path) -> Vec<Gap> {
    let Some(start) = text.find(&format!("\n{PROCEDURES}")) else {
        return Vec::new();
    };
    let (rules, procedures) = text.split_at(start + 1);
    let heading = procedures.len().min(PROCEDURES.len());
    let end = procedures[heading..].find("\n## ");
    let procedures = &procedures[..end.map_or(procedures.len(), |it| it + heading)];
    let mut gaps = Vec::new();
    let (mut is_table, mut has_fates) = (false, false);
    for (index, line) in rules.lines().enumerate() {
        if line.starts_with("## ") {
            is_table = TABLES.iter().any(|it| line.ends_with(it));
        }
        if let Some(mark) = FATES.iter().position(|it| *it == line) {
            has_fates = mark == 0;
        }
        let at = || SourceLine {
            file: file.to_owned(),
            line: index + 1,
        };
        let row = row(line).filter(|_| is_table);
        let fate = fate(line).filter(|_| has_fates);
        for name in row.into_iter().chain(fate) {
            if !mentions(procedures, name) {
                let name = name.to_owned();
                gaps.push(Gap::new(at(), GapKind::NoProcedure { name }));
            }
        }
    }
    gaps
}

/// The name in a row that begins with a number: `| 7 | RELEASE | …`, ``| 74 | `bad-release` | …``.
fn row(line: &str) -> Option<&str> {
    let mut cells = line.strip_prefix("| ")?.split(" | ");
    cells.next()?.parse::<u16>().ok()?;
    let cell = cells.next()?.trim_end_matches(" |");
    let code = cell.strip_prefix('`').and_then(|it| it.strip_suffix('`'));
    let frame = Some(cell).filter(|it| !it.contains(|it: char| it.is_ascii_lowercase()));
    code.or(frame).filter(|it| it.chars().all(is_of_name))
}

/// The name in a row of the table of fates: ``| `expired` | …``.
fn fate(line: &str) -> Option<&str> {
    Some(line.strip_prefix("| `")?.split_once('`')?.0)
}

/// Whether the text has this name as a whole word.
fn mentions(text: &str, name: &str) -> bool {
    text.match_indices(name).any(|(at, _)| {
        let (before, rest) = text.split_at(at);
        !before.ends_with(is_of_name) && !rest[name.len()..].starts_with(is_of_name)
    })
}

const fn is_of_name(it: char) -> bool {
    it.is_ascii_alphanumeric() || matches!(it, '_' | '-')
}
