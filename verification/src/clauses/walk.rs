//! The files that may have citations, and their syntax.

use std::fs;
use std::path::{Path, PathBuf};

use super::CheckError;

/// The syntax of citations in a file.
#[derive(Clone, Copy)]
pub(super) enum Syntax {
    /// By comment lines that start with this marker.
    Comments(&'static str),
    /// By the field `clause` of golden vectors.
    Vectors,
}

/// A file that may have citations.
pub(super) struct Source {
    pub(super) path: PathBuf,
    pub(super) syntax: Syntax,
}

impl Source {
    /// Whether the program in this file can name clauses.
    pub(super) fn names_clauses(&self) -> bool {
        self.path.extension().is_some_and(|it| it == "rs")
    }
}

/// Hidden folders that belong to the project.
const CI_FOLDERS: [&str; 2] = [".ci", ".github"];

/// All files below `root` that may have citations, in the order of their paths.
///
/// Build output (`target`), hidden folders but those of CI, and symbolic
/// links are passed over.
pub(super) fn sources(root: &Path) -> Result<Vec<Source>, CheckError> {
    let vectors = root.join("tests").join("vectors");
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        let fail = |source| CheckError::Read {
            path: folder.clone(),
            source,
        };
        for entry in fs::read_dir(&folder).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let path = entry.path();
            let kind = entry.file_type().map_err(fail)?;
            if kind.is_dir() && is_searched(&path) {
                folders.push(path);
            } else if kind.is_file() {
                let syntax = syntax(&path, &vectors);
                found.extend(syntax.map(|syntax| Source { path, syntax }));
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

fn is_searched(folder: &Path) -> bool {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    name != "target" && (!name.starts_with('.') || CI_FOLDERS.contains(&name.as_ref()))
}

fn syntax(file: &Path, vectors: &Path) -> Option<Syntax> {
    let Some(extension) = file.extension() else {
        // The CI scripts have no extension.
        let in_ci = file.parent().and_then(Path::file_name) == Some(".ci".as_ref());
        return in_ci.then_some(Syntax::Comments("#="));
    };
    match extension.to_str()? {
        "rs" => Some(Syntax::Comments("//=")),
        "toml" | "yml" | "sh" | "py" => Some(Syntax::Comments("#=")),
        "json" if file.starts_with(vectors) => Some(Syntax::Vectors),
        _ => None,
    }
}
