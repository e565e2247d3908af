//! Names that do not exist, and sockets that are not a Manager's.

use std::{fs, os::unix::net::UnixListener, process::Command};

use sm2_test_support::skip;

use crate::common::{Domain, Finished, Running, copy, sm2, talker};

fn run(arguments: &[&str]) -> Finished {
    Running::start(&mut sm2(arguments)).finish()
}

#[test]
fn what_is_not_there_is_told_with_what_may_be_meant() {
    let domain = Domain::new();
    let (_talker, node) = talker(&domain, "robot/scan");
    let _camera = domain.node("camera");
    let topic = domain.run(&["topic", "info", "scan"]);
    topic.failed(1, &["no topic scan; did you mean robot/scan?"]);
    let known = domain.run(&["node", "info", "camrea"]);
    known.failed(1, &["no node camrea; did you mean camera?"]);
    let strange = domain.run(&["node", "info", "something/else"]);
    strange.failed(1, &["no node something/else"]);
    assert!(!strange.stderr().contains("did you mean"), "{strange:?}");
    // The name of a topic does not stand for a node.
    domain
        .run(&["node", "info", "robot/scan"])
        .failed(1, &["no node"]);
    domain
        .run(&["topic", "info", &node])
        .failed(1, &["no topic"]);
    domain
        .run(&["topic", "info", "a b"])
        .failed(2, &["a name is segments"]);
}

#[test]
fn a_name_error_says_the_rule_once() {
    let wrong = run(&["topic", "info", "a b"]).stderr();
    assert_eq!(wrong.matches("A-Z a-z 0-9").count(), 1, "{wrong}");
    assert!(wrong.contains("' ' is none of these"), "{wrong}");
}

#[test]
fn a_path_that_is_no_managers_socket_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let stream = folder.path().join("stream.sock");
    let _listener = UnixListener::bind(&stream).unwrap();
    for path in ["/etc/passwd", "/tmp", stream.to_str().unwrap()] {
        let list = run(&["topic", "list", "--socket", path]);
        list.failed(1, &[path, "is not the socket of a Manager", "--socket"]);
        assert!(!list.stderr().contains("start one"), "{list:?}");
    }
    // --wait-manager does not wait for such a path.
    let waiting = run(&[
        "topic",
        "list",
        "--socket",
        "/etc/passwd",
        "--wait-manager",
        "60s",
    ]);
    waiting.failed(1, &["is not the socket of a Manager"]);
}

#[test]
fn a_socket_of_somebody_else_is_told_with_a_cure() {
    let domain = Domain::new();
    let socket = domain.path("sm2.sock");
    let socket = socket.to_str().unwrap();
    // Only root can run the test as another user: as `nobody`, with a copy of the program.
    let program = domain.path("sm2");
    copy(env!("CARGO_BIN_EXE_sm2"), &program);
    let open = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    fs::set_permissions(domain.path("."), open).unwrap();
    let mut command = Command::new("setpriv");
    command
        .args(["--reuid", "65534", "--regid", "65534", "--clear-groups"])
        .arg(&program)
        .args(["topic", "list", "--socket", socket]);
    if !nix::unistd::geteuid().is_root() || command.output().is_err() {
        skip("this needs root and setpriv");
        return;
    }
    let denied = Running::start(&mut command).finish();
    denied.failed(1, &[socket, "may not connect", "--socket-mode 660"]);

    // Nor may `nobody` start a Manager in a folder of root.
    let mut manager = Command::new("setpriv");
    manager
        .args(["--reuid", "65534", "--regid", "65534", "--clear-groups"])
        .arg(&program)
        .args(["manager", "--socket", "/root/sm2/manager.sock"]);
    let manager = Running::start(&mut manager).finish();
    manager.failed(1, &["/root/sm2", "Permission denied", "XDG_RUNTIME_DIR"]);
}
