//! The shipped programs, and how they may end.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
};

use nix::libc::SIGINT;
use sm2_tests::process::{Exit, Finished, Process};

/// The command `sm2`.
pub(crate) fn sm2(arguments: &[&str]) -> Command {
    let path = shipped("sm2");
    let mut command = Command::new(path.unwrap_or_else(|| env!("CARGO_BIN_EXE_sm2").into()));
    command.args(arguments);
    with_environment(command)
}

/// The Manager: the program `sm2-manager`, or `sm2 manager`.
pub(crate) fn manager(socket: &Path) -> Command {
    let mut command = own_program("manager");
    command.arg("--socket").arg(socket);
    command
}

/// The gateway: the program `sm2-gateway`, or `sm2 gateway`.
pub(crate) fn gateway(arguments: &[&str]) -> Command {
    let mut command = own_program("gateway");
    command.args(arguments);
    command
}

fn own_program(name: &str) -> Command {
    match shipped(&format!("sm2-{name}")) {
        Some(path) => with_environment(Command::new(path)),
        None => sm2(&[name]),
    }
}

/// The path of a program in the folder `SM2_BINARIES`, if it is set.
fn shipped(program: &str) -> Option<PathBuf> {
    env::var_os("SM2_BINARIES").map(|folder| {
        // Cargo runs a test in the folder of its package.
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        workspace.join(folder).join(program)
    })
}

/// An environment without a domain, where programs log warnings.
fn with_environment(mut command: Command) -> Command {
    for variable in ["SM2_SOCKET", "SM2_DOMAIN", "XDG_RUNTIME_DIR"] {
        command.env_remove(variable);
    }
    command.env("SM2_LOG", "warn,sm2_manager=info,sm2_gateway=info");
    command
}

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// It did its work, or was interrupted.
    Done,
    /// It failed, and said why.
    Failed,
}

/// Waits for the end of a program, and checks that it is one that a fault may cause.
#[track_caller]
pub(crate) fn end_of(process: &mut Process) -> (End, Finished) {
    let finished = process.finish();
    let Finished { exit, stderr, .. } = &finished;
    for wrong in ["panicked at", "broke the protocol"] {
        assert!(!stderr.contains(wrong), "{exit:?}: {stderr}");
    }
    let end = match exit {
        // 130 and the signal are for Ctrl-C before all work was done, and before the program catches signals.
        Exit::Status(0 | 130) | Exit::Signal(SIGINT) => End::Done,
        Exit::Status(1) => {
            let mut lines = stderr.lines();
            let is_reason = |line: &str| line.starts_with("sm2") && line.contains(": ");
            assert!(lines.any(is_reason), "failed without a reason: {stderr}");
            End::Failed
        }
        exit => panic!("{exit:?}: {stderr}"),
    };
    (end, finished)
}

/// As [`end_of`], for a program that must not fail.
#[track_caller]
pub(crate) fn done(process: &mut Process) -> Finished {
    let (end, finished) = end_of(process);
    assert_eq!(end, End::Done, "{}", finished.stderr);
    finished
}
