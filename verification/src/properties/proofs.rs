//! The functions behind a `kani::proof`.

use std::collections::BTreeSet;
use std::path::Path;
use std::{fs, io};

const MARKER: &str = "#[cfg_attr(kani, kani::proof)]";

/// The proofs of a source, below the path of its module.
#[must_use]
pub fn proofs(source: &str, module: &str) -> BTreeSet<String> {
    let name = |rest: &str| Some(rest.split_once("fn ")?.1.split_once('(')?.0.to_owned());
    let below = source.split(MARKER).skip(1).filter_map(name);
    below.map(|name| format!("{module}::{name}")).collect()
}

/// The proofs of all sources below a folder.
///
/// # Errors
/// A file or folder cannot be read.
pub fn proofs_below(folder: &Path, module: &str) -> io::Result<BTreeSet<String>> {
    let mut found = BTreeSet::new();
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
