//! All system calls of this crate go through one folder, so that a test can make each of them fail.

use std::fs;
use std::path::{Path, PathBuf};

/// The text of a direct system call, outside of the seam. `nix::errno` and the constants of `libc` are not calls.
const CALLS: [&str; 17] = [
    "nix::sys",
    "nix::fcntl",
    "nix::poll",
    "nix::unistd",
    "nix::time",
    "nix::mount",
    "nix::sched",
    "nix::{",
    "libc::{",
    "std::fs::{self",
    "std::fs;",
    "std::fs::read",
    "fs::FileExt",
    "fs::OpenOptionsExt",
    "try_clone",
    "file.set_len(",
    "std::net::Unix",
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|it| it == "rs") {
            found.push(path);
        }
    }
}

/// The direct system calls in a text.
fn calls(text: &str) -> Vec<String> {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or("");
    let code = code.lines().filter(|it| !it.trim_start().starts_with("//"));
    let is_libc_call = |line: &str| {
        line.split("libc::").skip(1).any(|rest| {
            let name = rest.trim_start_matches(|it: char| {
                it.is_ascii_lowercase() || it == '_' || it.is_ascii_digit()
            });
            name.starts_with('(') && rest.starts_with(|it: char| it.is_ascii_lowercase())
        })
    };
    let is_call = |line: &&str| is_libc_call(line) || CALLS.iter().any(|it| line.contains(it));
    code.filter(is_call).map(str::to_owned).collect()
}

#[test]
fn no_file_outside_of_the_seam_makes_a_system_call() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&source, &mut files);
    assert!(files.len() > 40, "{files:?}");
    let mut offenders = Vec::new();
    for path in files {
        if path.starts_with(source.join("syscall")) {
            continue;
        }
        let found = calls(&fs::read_to_string(&path).unwrap());
        offenders.extend(found.into_iter().map(|line| (path.clone(), line)));
    }
    assert_eq!(offenders, [], "put these calls into src/syscall");
}

#[test]
fn direct_calls_are_found() {
    for text in [
        "let n = unsafe { libc::read(fd, p, 1) };",
        "use nix::sys::mman;",
        "use std::os::unix::fs::FileExt;",
        "let copy = file.try_clone()?;",
        "file.set_len(4096)?;",
    ] {
        assert_eq!(calls(text).len(), 1, "{text}");
    }
    for text in [
        "use nix::errno::Errno;",
        "libc::EINTR",
        "// libc::read(1)",
        "x: libc::c_int,",
    ] {
        assert!(calls(text).is_empty(), "{text}");
    }
}
