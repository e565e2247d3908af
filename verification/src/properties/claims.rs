//! Comments in sources that say what a check shows.
//!
//! Such a comment reads `// Shows NAME, NAME (WORD), bound: TEXT.`, in one or more lines. WORD is the strength of a
//! harness's result, or the engine of another check. `, full` behind it marks a check that only a full run has. Without
//! a bound, that of the engine holds.

use std::path::Path;
use std::{fs, io};

use super::check::{Check, Run};
use super::engine::Engine;

/// Where the claims of a kind of checks are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// At the head of the file, whose path is the check's name.
    File,
    /// At the head of the file, whose name without its extension is the check's name.
    Stem,
    /// Above the code whose first string is the check's name.
    Code,
}

/// The comment of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Claim {
    /// The names of the properties that the check shows.
    pub(super) shows: Vec<String>,
    /// The text between parentheses.
    pub(super) word: String,
    /// The number of the line behind the comment, counted from 0.
    pub(super) end: usize,
}

/// The comments of a source that say what a check shows.
pub(super) fn claims(source: &str) -> Vec<Claim> {
    let lines: Vec<_> = source.lines().map(str::trim_start).collect();
    let starts = (0..lines.len()).filter(|line| lines[*line].starts_with("// Shows "));
    let claim = |start: usize| {
        let mut comment = Vec::new();
        comment.extend(lines[start..].iter().map_while(|it| it.strip_prefix("// ")));
        let text = comment.join(" ");
        let (shows, rest) = text.strip_prefix("Shows ")?.split_once(" (")?;
        let (word, _) = rest.split_once(')')?;
        Some(Claim {
            shows: shows.split(", ").map(str::to_owned).collect(),
            word: word.to_owned(),
            end: start + comment.len(),
        })
    };
    starts.filter_map(claim).collect()
}

/// The checks of a source that is at `path` below the root of the workspace.
///
/// # Errors
/// A comment names no engine, or no name follows it.
pub fn checks_of(source: &str, path: &str, place: Place) -> Result<Vec<Check>, String> {
    let is_head = |it: &&str| it.starts_with("//") || it.is_empty();
    let head = source.lines().take_while(is_head).count();
    let mut claims = claims(source);
    if place != Place::Code {
        claims.retain(|it| it.end <= head);
    }
    let check = |claim: Claim| {
        let (word, run) = match claim.word.strip_suffix(", full") {
            Some(word) => (word, Run::Full),
            None => (claim.word.as_str(), Run::Quick),
        };
        let below: Vec<_> = source.lines().skip(claim.end).collect();
        let harness = match place {
            Place::File => Some(path.to_owned()),
            Place::Stem => Path::new(path)
                .file_stem()
                .and_then(|it| it.to_str())
                .map(str::to_owned),
            Place::Code => below.join("\n").split('"').nth(1).map(str::to_owned),
        };
        Ok(Check {
            harness: harness.ok_or_else(|| format!("{path}: a comment without a check"))?,
            engine: Engine::named(word)
                .ok_or_else(|| format!("{path}: there is no engine `{word}`"))?,
            shows: claim.shows,
            run,
            strength: None,
            line: None,
        })
    };
    claims.into_iter().map(check).collect()
}

/// The checks of all sources of a folder, or of one source, below the root of the workspace.
///
/// # Errors
/// A file or folder cannot be read, or [`checks_of`] fails.
pub(super) fn checks_in(root: &Path, path: &str, place: Place) -> io::Result<Vec<Check>> {
    let mut files = vec![path.to_owned()];
    if root.join(path).is_dir() {
        files.clear();
        for entry in fs::read_dir(root.join(path))? {
            files.push(format!("{path}/{}", entry?.file_name().to_string_lossy()));
        }
        files.retain(|it| Path::new(it).extension().is_some_and(|it| it == "rs"));
        files.sort();
    }
    let mut checks = Vec::new();
    for file in files {
        let source = fs::read_to_string(root.join(&file))?;
        checks.extend(checks_of(&source, &file, place).map_err(io::Error::other)?);
    }
    Ok(checks)
}
