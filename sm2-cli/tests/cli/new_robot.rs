//! `sm2 new`.

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use nix::sys::signal::Signal;
use sm2_test_support::memory;
use tempfile::TempDir;

use crate::common::{Finished, Running, sm2, until};

fn new(folder: &Path, arguments: &[&str]) -> Finished {
    let mut command = sm2(&["new"]);
    Running::start(command.current_dir(folder).args(arguments)).finish()
}

fn folder() -> TempDir {
    tempfile::tempdir_in(memory()).unwrap()
}

/// The folder of the repository.
fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .unwrap()
}

#[test]
fn a_robot_has_nodes_and_names_the_libraries_by_their_version() {
    let folder = folder();
    let made = new(folder.path(), &["rover"]);
    assert_eq!(made.code(), 0, "{made:?}");
    assert!(
        made.stdout().starts_with("made rover: cd rover"),
        "{made:?}"
    );
    let read = |path: &str| fs::read_to_string(folder.path().join("rover").join(path)).unwrap();
    let manifest = read("Cargo.toml");
    let version = env!("CARGO_PKG_VERSION");
    assert!(
        manifest.contains(&format!("sm2-node = {{ version = \"{version}\" }}\n")),
        "{manifest}"
    );
    assert!(!manifest.contains("path"), "{manifest}");
    let readme = read("README.md");
    assert!(readme.starts_with("# rover\n"), "{readme}");
    assert_eq!(readme.lines().count(), 10, "{readme}");
    for path in [
        "lidar/src/main.rs",
        "driver/src/main.rs",
        "driver/tests/driver.rs",
        "params.toml",
    ] {
        assert!(!read(path).is_empty(), "{path}");
    }
}

#[test]
fn nothing_is_overwritten() {
    let folder = folder();
    let path = folder.path().join("rover");
    fs::create_dir(&path).unwrap();
    new(folder.path(), &["rover"]).failed(1, &["rover exists, and is not changed"]);
    assert_eq!(fs::read_dir(&path).unwrap().count(), 0);
    fs::remove_dir(&path).unwrap();
    fs::write(&path, "text").unwrap();
    new(folder.path(), &["rover"]).failed(1, &["rover exists, and is not changed"]);
    assert_eq!(fs::read_to_string(&path).unwrap(), "text");
}

#[test]
fn names_and_paths_are_checked() {
    let folder = folder();
    let long = "x".repeat(65);
    for name in ["", "a/b", "..", "1a", "-a", "a b", "ä", &long] {
        let wrong = new(folder.path(), &["--", name]);
        wrong.failed(2, &["a name has 1 to 64 characters", "sm2 new --help"]);
    }
    new(folder.path(), &["a", "--sm2-path", "none"]).failed(1, &["cannot find none"]);
    new(folder.path(), &["a", "--sm2-path", "."]).failed(1, &["has no sm2-node/Cargo.toml"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// The whole way of README. Cargo takes the versions of the repository's lock file, and stays offline. The build
/// stays in the target folder of this test's build, for the next time.
#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn a_robot_builds_passes_its_test_and_runs() {
    let folder = folder();
    let repository = repository();
    let made = new(
        folder.path(),
        &["rover", "--sm2-path", repository.to_str().unwrap()],
    );
    assert_eq!(made.code(), 0, "{made:?}");
    let rover = folder.path().join("rover");
    fs::copy(repository.join("Cargo.lock"), rover.join("Cargo.lock")).unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_sm2"));
    let target = program.ancestors().nth(2).unwrap().join("new-robot");
    for arguments in [&["test", "--offline"][..], &["build", "--offline"]] {
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            .args(arguments)
            .current_dir(&rover)
            .env("CARGO_TARGET_DIR", &target);
        let output = cargo.output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {text}");
    }
    // The programs were not optimized, since that takes minutes.
    fs::create_dir(rover.join("target")).unwrap();
    symlink(target.join("debug"), rover.join("target/release")).unwrap();
    let mut up = sm2(&["up", "--socket"]);
    let socket = rover.join("sm2.sock");
    let up = Running::start(up.arg(&socket).current_dir(&rover));
    let mut echo = sm2(&[
        "topic",
        "echo",
        "speed",
        "--count",
        "3",
        "--wait-manager",
        "60s",
        "--socket",
    ]);
    let echo = Running::start(echo.arg(&socket)).finish();
    assert_eq!(echo.code(), 0, "{echo:?}\n{}", up.stdout());
    assert!(echo.stdout().starts_with("0.5\n"), "{echo:?}");
    up.signal(Signal::SIGINT);
    let up = up.finish();
    assert_eq!(up.code(), 0, "{up:?}");
    for line in ["lidar   | ends", "driver  | ends"] {
        assert!(
            up.stdout().contains(line),
            "{line} is not in\n{}",
            up.stdout()
        );
    }
    until("the socket is gone", || !socket.exists());
}
