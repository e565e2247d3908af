//! Runs of identical lines in two places. Blank lines, comments, lone punctuation and `use` do not
//! count, and neither does indentation.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

/// So many lines in a row may not stand twice.
pub(crate) const LINES: usize = 10;

/// The second of two places with the same lines, and where the first one is.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Repetition {
    pub(crate) file: PathBuf,
    pub(crate) line: usize,
    pub(crate) first: (PathBuf, usize),
    /// How many lines that count are the same.
    pub(crate) count: usize,
}

/// All repetitions between the given files and within each.
pub(crate) fn repetitions<'a>(
    files: impl IntoIterator<Item = (&'a Path, &'a str)>,
) -> Vec<Repetition> {
    let mut seen: HashMap<Vec<&str>, (&Path, usize, usize)> = HashMap::new();
    let mut found: Vec<Repetition> = Vec::new();
    for (path, text) in files {
        let lines = lines_that_count(text);
        // Windows below this index belong to the repetition that was noted last.
        let mut noted: Option<(usize, &Path, usize)> = None;
        for (index, window) in lines.windows(LINES).enumerate() {
            let key: Vec<&str> = window.iter().map(|it| it.1).collect();
            let Some(&(first, first_index, first_line)) = seen.get(&key) else {
                seen.insert(key, (path, index, window[0].0));
                noted = None;
                continue;
            };
            let overlaps = first == path && first_index + LINES > index;
            let goes_on = noted == Some((index, first, first_index));
            if goes_on && let Some(last) = found.last_mut() {
                last.count += 1;
            } else if !overlaps {
                found.push(Repetition {
                    file: path.to_owned(),
                    line: window[0].0,
                    first: (first.to_owned(), first_line),
                    count: LINES,
                });
            } else {
                continue;
            }
            noted = Some((index + 1, first, first_index + 1));
        }
    }
    found
}

/// Number and text of each line that counts.
fn lines_that_count(text: &str) -> Vec<(usize, &str)> {
    let mut in_use = false;
    let mut lines = Vec::new();
    for (line, number) in text.lines().map(str::trim).zip(1..) {
        in_use |= ["use ", "pub use ", "pub(crate) use "]
            .iter()
            .any(|it| line.starts_with(it));
        let is_code = !line.starts_with("//") && line.contains(char::is_alphanumeric);
        if is_code && !in_use {
            lines.push((number, line));
        }
        in_use &= !line.ends_with(';');
    }
    lines
}
