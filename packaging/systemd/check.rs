//! Checks of the units of one program, for the tests of its crate. They are skipped where systemd is not installed.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The units of a program in this folder.
pub(crate) struct Units {
    /// The name of the program.
    pub(crate) program: &'static str,
    /// The path of the built program.
    pub(crate) path: &'static str,
}

/// A folder with units, relative to `packaging/systemd`, and the kind of instance that loads them.
pub(crate) const SYSTEM: (&str, &str) = ("", "--system");

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/systemd")
}

/// Runs `systemd-analyze`; `None` if it is not installed.
fn analyze(arguments: &mut Command) -> Option<Output> {
    let output = arguments.output();
    output
        .inspect_err(|error| sm2_test_support::skip_without("systemd-analyze", error))
        .ok()
}

impl Units {
    /// Asserts that systemd accepts all units of a folder.
    pub(crate) fn are_accepted(&self, (under, option): (&str, &str)) {
        let copies = tempfile::tempdir().unwrap();
        let units = self.copy(&folder().join(under), copies.path());
        assert!(!units.is_empty(), "{under}");
        let mut verify = Command::new("systemd-analyze");
        verify.args(["verify", option]).args(units);
        verify.env("XDG_RUNTIME_DIR", copies.path());
        let Some(output) = analyze(&mut verify) else {
            return;
        };
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.is_empty(), "{text}");
    }

    /// Copies the units, with the path of the built program, and instantiates each template.
    fn copy(&self, from: &Path, to: &Path) -> Vec<PathBuf> {
        let mut units = vec![];
        for entry in fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let is_unit = name.ends_with(".service") || name.ends_with(".socket");
            if !is_unit || !name.starts_with(self.program) {
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let text = text.replace(&format!("/usr/bin/{}", self.program), self.path);
            // The command is built by another package.
            let text = text.replace("/usr/bin/sm2 ", "/bin/true ");
            fs::write(to.join(name), &text).unwrap();
            let unit = to.join(name.replace('@', "@arm"));
            fs::write(&unit, text).unwrap();
            units.push(unit);
        }
        units
    }

    /// Asserts that the program has all options that a unit passes.
    pub(crate) fn options_exist(&self, unit: &str) {
        let text = fs::read_to_string(folder().join(unit)).unwrap();
        let start = text.lines().find_map(|it| it.strip_prefix("ExecStart="));
        let mut words = start.unwrap().split_whitespace();
        assert_eq!(words.next(), Some(&*format!("/usr/bin/{}", self.program)));
        let mut command = Command::new(self.path);
        let output = command.args(words).arg("--help").output().unwrap();
        assert!(output.status.success(), "{unit}: {output:?}");
    }
}

/// Asserts that the exposure of a unit by the measure of `systemd-analyze security`, in tenths, is at most `most`.
pub(crate) fn is_hardened(unit: &str, most: u32) {
    let mut security = Command::new("systemd-analyze");
    security.args(["security", "--no-pager", "--offline=yes"]);
    security.arg(format!("--threshold={most}"));
    let Some(output) = analyze(security.arg(folder().join(unit))) else {
        return;
    };
    let text = String::from_utf8_lossy(&output.stdout);
    let score = text.lines().last().unwrap_or_default();
    println!("{score}");
    assert!(output.status.success(), "{text}");
}
