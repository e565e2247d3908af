//! The functions behind a `kani::proof`, and the comments that say what they show.

use std::path::Path;
use std::{fs, io};

use super::claims::claims;

const MARKER: &str = "#[cfg_attr(kani, kani::proof)]";

/// A harness: a function behind a `kani::proof`.
///
/// The comment above the attribute reads `// Shows NAME, NAME (STRENGTH), bound: TEXT.`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proof {
    /// The path of the function.
    pub name: String,
    /// The names of the properties that it shows; empty if the comment is missing.
    pub shows: Vec<String>,
    /// The strength of the stand-in's result: `Exhaustive`.
    pub strength: String,
}

/// The proofs of a source, below the path of its module.
#[must_use]
pub fn proofs(source: &str, module: &str) -> Vec<Proof> {
    let parts: Vec<_> = source.split(MARKER).collect();
    let pairs = parts.windows(2);
    let proof = |pair: &[&str]| {
        let function = pair[1].split_once("fn ")?.1.split_once('(')?.0;
        let (shows, strength) = claim(pair[0]).unwrap_or_default();
        Some(Proof {
            name: format!("{module}::{function}"),
            shows,
            strength,
        })
    };
    pairs.filter_map(proof).collect()
}

/// The properties and the strength in the comment at the end of a text.
fn claim(before: &str) -> Option<(Vec<String>, String)> {
    let claim = claims(before).pop()?;
    let mut rest = before.trim_end().lines().skip(claim.end);
    let is_above = rest.all(|it| it.trim_start().starts_with("//"));
    is_above.then_some((claim.shows, claim.word))
}

/// The proofs of all sources below a folder.
///
/// # Errors
/// A file or folder cannot be read.
pub fn proofs_below(folder: &Path, module: &str) -> io::Result<Vec<Proof>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let module = match stem.as_ref() {
            "lib" | "mod" => module.to_owned(),
            stem => format!("{module}::{stem}"),
        };
        if path.is_dir() {
            found.extend(proofs_below(&path, &module)?);
        } else {
            found.extend(proofs(&fs::read_to_string(&path)?, &module));
        }
    }
    Ok(found)
}
