//! A copy of the workspace, so that the workspace itself is never changed.

use std::{
    collections::BTreeSet,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
};

use super::MutantsError;

/// The copy.
#[derive(Debug)]
pub(super) struct Tree {
    root: PathBuf,
}

impl Tree {
    /// Makes `to` a copy of `from`, without build output and hidden files. Files that are equal
    /// already are not written: Cargo rebuilds files that are newer than its last build.
    pub(super) fn copy(from: &Path, to: &Path) -> Result<Self, MutantsError> {
        mirror(from, to)?;
        let root = to.to_owned();
        Ok(Self { root })
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    pub(super) fn read(&self, file: &Path) -> Result<String, MutantsError> {
        let path = self.root.join(file);
        fs::read_to_string(&path).map_err(MutantsError::file(path))
    }

    pub(super) fn write(&self, file: &Path, text: &str) -> Result<(), MutantsError> {
        let path = self.root.join(file);
        fs::write(&path, text).map_err(MutantsError::file(path))
    }
}

fn is_copied(name: &OsStr) -> bool {
    name != "target" && !name.as_encoded_bytes().starts_with(b".")
}

fn mirror(from: &Path, to: &Path) -> Result<(), MutantsError> {
    fs::create_dir_all(to).map_err(MutantsError::file(to))?;
    let mut there = BTreeSet::new();
    for (name, path) in entries(from)? {
        if !is_copied(&name) {
            continue;
        }
        let copy = to.join(&name);
        if path.is_dir() {
            mirror(&path, &copy)?;
        } else {
            copy_file(&path, &copy)?;
        }
        there.insert(name);
    }
    // Files that are gone in `from`, or that a check has left.
    for (_, path) in entries(to)?.into_iter().filter(|it| !there.contains(&it.0)) {
        let removed = if path.is_dir() {
            fs::remove_dir_all(&path)
        } else {
            fs::remove_file(&path)
        };
        removed.map_err(MutantsError::file(path))?;
    }
    Ok(())
}

fn copy_file(from: &Path, to: &Path) -> Result<(), MutantsError> {
    let wanted = fs::read(from).map_err(MutantsError::file(from))?;
    if fs::read(to).is_ok_and(|found| found == wanted) {
        return Ok(());
    }
    // Copies the permissions, too: some files are scripts.
    fs::copy(from, to).map(drop).map_err(MutantsError::file(to))
}

fn entries(folder: &Path) -> Result<Vec<(std::ffi::OsString, PathBuf)>, MutantsError> {
    let all = fs::read_dir(folder).map_err(MutantsError::file(folder))?;
    let all = all.map(|entry| entry.map(|it| (it.file_name(), it.path())));
    all.collect::<Result<_, _>>()
        .map_err(MutantsError::file(folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_copy_is_what_the_workspace_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let [from, to] = ["from", "to"].map(|it| folder.path().join(it));
        for file in ["a/code.rs", "b.toml", "target/built", ".git/config"] {
            let file = from.join(file);
            fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
            fs::write(file, "as it is").expect("a file");
        }
        let tree = Tree::copy(&from, &to).expect("a copy");
        let file = Path::new("a/code.rs");
        assert_eq!(tree.read(file).expect("a file"), "as it is");
        assert!(!to.join("target").exists() && !to.join(".git").exists());
        let age = |file: &str| fs::metadata(to.join(file)).and_then(|it| it.modified());
        let before = age("b.toml").expect("a time");
        // A run that was interrupted, and what its check left.
        tree.write(file, "faulty").expect("a file");
        fs::create_dir_all(to.join("left/behind")).expect("a folder");
        Tree::copy(&from, &to).expect("a copy");
        assert_eq!(tree.read(file).expect("a file"), "as it is");
        assert!(!to.join("left").exists());
        assert_eq!(age("b.toml").expect("a time"), before);
        assert_eq!(
            fs::read_to_string(from.join(file)).expect("a file"),
            "as it is"
        );
    }
}
