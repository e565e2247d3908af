//! The sources and documents of a tree, read once; made-up ones for the tests of the checks.

use std::{
    collections::BTreeMap,
    fmt, fs,
    path::{Path, PathBuf},
};

/// Folders that hold no source of this repository: what builds, git and mdbook write.
const SKIPPED_FOLDERS: &[&str] = &["target", ".git", "book"];

/// Ends of the names of files that are read.
const READ_SUFFIXES: &[&str] = &[".rs", ".md", "Cargo.toml"];

/// A line that breaks a rule, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Finding {
    pub(crate) file: PathBuf,
    /// The first line is 1.
    pub(crate) line: usize,
    pub(crate) text: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, line, text } = self;
        write!(f, "{}:{line}: {text}", file.display())
    }
}

/// Text by path; paths are relative to the root of the tree.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    files: BTreeMap<PathBuf, String>,
}

impl Sources {
    /// All Rust and Markdown files and all manifests below `root`.
    pub(crate) fn read(root: &Path) -> Self {
        let mut sources = Self::default();
        sources.read_folder(root, Path::new(""));
        sources
    }

    fn read_folder(&mut self, root: &Path, folder: &Path) {
        let entries = fs::read_dir(root.join(folder)).expect("a folder of the repository");
        for entry in entries {
            let entry = entry.expect("an entry of a folder");
            let name = entry.file_name().into_string().expect("a name in UTF-8");
            let path = folder.join(&name);
            if entry.file_type().expect("the type of an entry").is_dir() {
                if !SKIPPED_FOLDERS.contains(&name.as_str()) {
                    self.read_folder(root, &path);
                }
            } else if READ_SUFFIXES.iter().any(|it| name.ends_with(it)) {
                let text = fs::read_to_string(root.join(&path)).expect("a source in UTF-8");
                self.files.insert(path, text);
            }
        }
    }

    /// A tree that exists only in a test.
    pub(crate) fn made_up(files: &[(&str, &str)]) -> Self {
        let owned = |&(path, text): &(&str, &str)| (PathBuf::from(path), text.to_owned());
        Self {
            files: files.iter().map(owned).collect(),
        }
    }

    pub(crate) fn get(&self, path: &Path) -> Option<&str> {
        self.files.get(path).map(String::as_str)
    }

    /// All Rust files, in the order of their paths.
    pub(crate) fn rust(&self) -> impl Iterator<Item = (&Path, &str)> {
        self.with_extension("rs")
    }

    /// All Markdown files, in the order of their paths.
    pub(crate) fn markdown(&self) -> impl Iterator<Item = (&Path, &str)> {
        self.with_extension("md")
    }

    fn with_extension(&self, extension: &'static str) -> impl Iterator<Item = (&Path, &str)> {
        let files = self.files.iter();
        files
            .map(|(path, text)| (path.as_path(), text.as_str()))
            .filter(move |(path, _)| path.extension().is_some_and(|it| it == extension))
    }

    /// The root files of all crates whose modules may depend on each other: libraries, programs
    /// and fuzz targets, but no tests, examples and benchmarks.
    pub(crate) fn crate_roots(&self) -> Vec<&Path> {
        let manifests = self.files.keys().filter(|it| it.ends_with("Cargo.toml"));
        let packages: Vec<&Path> = manifests.filter_map(|it| it.parent()).collect();
        let is_root = |path: &Path| {
            let package = packages.iter().filter(|it| path.starts_with(it));
            let package = package.max_by_key(|it| it.components().count());
            let Some(inside) = package.and_then(|it| path.strip_prefix(it).ok()) else {
                return false;
            };
            let folder = inside.parent();
            inside == Path::new("src/lib.rs")
                || inside == Path::new("src/main.rs")
                || folder == Some(Path::new("src/bin"))
                || (inside.starts_with("src/bin") && inside.ends_with("main.rs"))
                || folder == Some(Path::new("fuzz_targets"))
        };
        let paths = self.rust().map(|(path, _)| path);
        paths.filter(|path| is_root(path)).collect()
    }
}
