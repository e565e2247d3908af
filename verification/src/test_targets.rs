//! The programs that contain the integration tests of a file.
//!
//! The files of `CRATE/tests/` are modules of one program (`tests/main.rs`), or of `tests/slow.rs`; a few are programs
//! of their own. Rows of PROPERTIES.md and entries of `mutants.toml` name files, so that they need not change when a
//! file moves to another program.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::Deserialize;

/// A program of tests, and the module of a file in it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TestTarget {
    /// The name of the program, for `cargo test --test`.
    pub name: String,
    /// `module::`, or nothing if the file is the whole program.
    pub prefix: String,
    /// True if the program is built only with the feature `slow`.
    pub is_slow: bool,
}

impl TestTarget {
    /// The program with the tests of `tests/FILE.rs` of the package in this folder. Without an entry in its
    /// `Cargo.toml`, the file is a program of its own, as Cargo has it.
    ///
    /// # Errors
    ///
    /// `Cargo.toml`, or the main file of a program that it names, cannot be read.
    pub fn of(package: &Path, file: &str) -> io::Result<Self> {
        let text = fs::read_to_string(package.join("Cargo.toml"))?;
        let manifest: Manifest = toml::from_str(&text).map_err(io::Error::other)?;
        let declares = |line: &str| {
            let line = line.trim_start_matches("pub(crate) ");
            line == format!("mod {file};")
        };
        for entry in manifest.test {
            let path = entry.path();
            if path == Path::new("tests").join(file).with_extension("rs") {
                return Ok(entry.target(String::new()));
            }
            if fs::read_to_string(package.join(path))?
                .lines()
                .any(declares)
            {
                return Ok(entry.target(format!("{file}::")));
            }
        }
        Ok(Self {
            name: file.to_owned(),
            prefix: String::new(),
            is_slow: false,
        })
    }
}

#[derive(Deserialize)]
struct Manifest {
    #[serde(default)]
    test: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
struct Entry {
    name: String,
    path: Option<PathBuf>,
    #[serde(default)]
    required_features: Vec<String>,
}

impl Entry {
    fn path(&self) -> PathBuf {
        let default = || Path::new("tests").join(&self.name).with_extension("rs");
        self.path.clone().unwrap_or_else(default)
    }

    fn target(self, prefix: String) -> TestTarget {
        TestTarget {
            is_slow: self.required_features.iter().any(|it| it == "slow"),
            name: self.name,
            prefix,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::TestTarget;
    use std::fs;

    #[test]
    fn a_file_is_a_module_or_a_program() {
        let folder = tempfile::tempdir().expect("a folder");
        let manifest = r#"
            [[test]]
            name = "all"
            path = "tests/main.rs"
            [[test]]
            name = "all-slow"
            path = "tests/slow.rs"
            required-features = ["slow"]
            [[test]]
            name = "alone"
        "#;
        fs::write(folder.path().join("Cargo.toml"), manifest).expect("a file");
        fs::create_dir(folder.path().join("tests")).expect("a folder");
        fs::write(folder.path().join("tests/main.rs"), "mod one;\n").expect("a file");
        fs::write(folder.path().join("tests/slow.rs"), "mod long;\n").expect("a file");
        let of = |file| {
            let target = TestTarget::of(folder.path(), file).expect("a target");
            (target.name, target.prefix, target.is_slow)
        };
        let owned =
            |name: &str, prefix: &str, is_slow| (name.to_owned(), prefix.to_owned(), is_slow);
        assert_eq!(of("one"), owned("all", "one::", false));
        assert_eq!(of("long"), owned("all-slow", "long::", true));
        // The programs themselves come before the files that are read.
        fs::write(folder.path().join("tests/alone.rs"), "").expect("a file");
        assert_eq!(of("alone"), owned("alone", "", false));
        assert_eq!(of("other"), owned("other", "", false));
    }
}
