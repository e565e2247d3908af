//! The unit files in `packaging/systemd`, checked by systemd where it is installed.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Copies the units, with the path of the built program, and instantiates each template.
fn copy_units(from: &Path, to: &Path) -> Vec<PathBuf> {
    let mut units = vec![];
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if !name.ends_with(".service") && !name.ends_with(".socket") {
            continue;
        }
        let text = fs::read_to_string(&path).unwrap();
        let program = env!("CARGO_BIN_EXE_sm2-manager");
        let text = text.replace("/usr/bin/sm2-manager", program);
        // The command is built by another package.
        let text = text.replace("/usr/bin/sm2 ", "/bin/true ");
        fs::write(to.join(name), &text).unwrap();
        let unit = to.join(name.replace('@', "@arm"));
        fs::write(&unit, text).unwrap();
        units.push(unit);
    }
    units
}

#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    let packaging = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/systemd");
    for (folder, option) in [("", "--system"), ("user", "--user")] {
        let copies = tempfile::tempdir().unwrap();
        let units = copy_units(&packaging.join(folder), copies.path());
        assert!(!units.is_empty(), "{folder}");
        let mut verify = Command::new("systemd-analyze");
        verify.args(["verify", option]).args(units);
        verify.env("XDG_RUNTIME_DIR", copies.path());
        let Ok(output) = verify.output() else {
            println!("skipped: systemd-analyze is not installed");
            return;
        };
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.is_empty(), "{text}");
    }
}

/// The program accepts all options that the units pass.
#[test]
fn the_units_use_options_that_exist() {
    let packaging = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/systemd");
    for name in [
        "sm2-manager.service",
        "sm2-manager@.service",
        "user/sm2-manager.service",
    ] {
        let text = fs::read_to_string(packaging.join(name)).unwrap();
        let start = text.lines().find_map(|it| it.strip_prefix("ExecStart="));
        let mut words = start.unwrap().split_whitespace();
        assert_eq!(words.next(), Some("/usr/bin/sm2-manager"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-manager"));
        let output = command.args(words).arg("--help").output().unwrap();
        assert!(output.status.success(), "{name}: {output:?}");
    }
}

/// The exposure of a Manager by the measure of `systemd-analyze security`, in tenths: 0 to 100.
const EXPOSURE_MOST: &str = "4";

#[test]
fn systemd_finds_the_managers_units_hardened() {
    let packaging = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging/systemd");
    for name in ["sm2-manager.service", "sm2-manager@.service"] {
        let mut analyze = Command::new("systemd-analyze");
        analyze.args(["security", "--no-pager", "--offline=yes"]);
        analyze.arg(format!("--threshold={EXPOSURE_MOST}"));
        let Ok(output) = analyze.arg(packaging.join(name)).output() else {
            println!("skipped: systemd-analyze is not installed");
            return;
        };
        let text = String::from_utf8_lossy(&output.stdout);
        let score = text.lines().last().unwrap_or_default();
        println!("{score}");
        assert!(output.status.success(), "{text}");
    }
}
