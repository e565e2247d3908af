//! Packages of definitions in temporary folders, and the code that is generated from them.

use std::fs;
use std::path::{Path, PathBuf};

use sm2_ros_build::{Builder, Error};

/// A folder with the package `p`.
pub(crate) struct Definitions {
    folder: tempfile::TempDir,
}

impl Definitions {
    /// The package `p` with these files, such as `msg/T.msg`.
    pub(crate) fn new(files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let definitions = Self { folder };
        for (file, text) in files {
            definitions.write(&format!("p/{file}"), text);
        }
        definitions
    }

    /// Writes a file, such as `p/msg/T.msg`.
    pub(crate) fn write(&self, file: &str, text: &str) {
        let path = self.path(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.root().join(file)
    }

    pub(crate) fn root(&self) -> &Path {
        self.folder.path()
    }

    /// Generates the code of `p`, without the common interfaces.
    pub(crate) fn code(&self) -> Result<String, Error> {
        self.builder().common_interfaces(false).code()
    }

    /// A builder of `p` with the common interfaces, because services and actions refer to them.
    pub(crate) fn builder(&self) -> Builder {
        Builder::new().package(self.path("p"))
    }
}

/// The code of the message `p/msg/T`.
pub(crate) fn code_of(text: &str) -> Result<String, Error> {
    Definitions::new(&[("msg/T.msg", text)]).code()
}

/// Asserts that the code has these lines, apart from their indentation.
pub(crate) fn assert_lines(code: &str, lines: &[&str]) {
    for line in lines {
        let has = code.lines().any(|it| it.trim() == *line);
        assert!(has, "no line {line:?} in:\n{code}");
    }
}
