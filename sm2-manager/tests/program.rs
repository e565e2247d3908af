//! The program at paths that it can use and at others.

use std::{
    fs::{self, Permissions},
    io::IoSlice,
    os::{
        fd::AsFd,
        unix::{fs::PermissionsExt, process::CommandExt},
    },
};

use crate::common::{self, Program, SOON, TestDomain};
use nix::{sys::signal::Signal, unistd::geteuid};
use sm2_io::{SeqPacket, wait_readable};

//= SM2-TRN-007 sys
#[test]
fn a_lock_file_that_was_left_over_is_no_obstacle() {
    let domain = TestDomain::new();
    fs::write(domain.folder().join("domain.sock.lock"), "").unwrap();
    let mut manager = domain.manager(&[]);
    assert_eq!(domain.client("node").server(), manager.pid());
    manager.signal(Signal::SIGINT);
    assert_eq!(manager.wait(), Some(0));
    assert!(domain.files().is_empty(), "{:?}", domain.files());
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error() {
    let domain = TestDomain::new();
    for option in [&[][..], &["--standby"], &["--replace"]] {
        let mut command = domain.for_a_stranger(option);
        let permissions = Permissions::from_mode(0o555);
        fs::set_permissions(domain.folder(), permissions).unwrap();
        if geteuid().is_root() {
            // Root could write everywhere.
            command.uid(65_534).gid(65_534);
        }
        let mut manager = Program::start(command);
        assert_eq!(manager.wait(), Some(1), "{option:?}");
        manager.says("domain.sock.lock");
        manager.says("ermission denied");
        let permissions = Permissions::from_mode(0o755);
        fs::set_permissions(domain.folder(), permissions).unwrap();
    }
}

#[test]
fn help_says_what_can_be_done_and_how_it_ends() {
    let domain = TestDomain::new();
    let output = domain.command(&["--help"]).output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    for word in [
        "--standby",
        "--replace",
        "SIGUSR2",
        "Exit status: 0",
        "Examples:",
    ] {
        assert!(text.contains(word), "{word} in {text}");
    }
}

/// A Manager executes no program, so it gives up the right to gain rights by one.
#[test]
fn a_manager_gives_up_the_right_to_gain_rights() {
    let domain = TestDomain::new();
    let manager = domain.manager(&[]);
    let threads = fs::read_dir(format!("/proc/{}/task", manager.pid())).unwrap();
    for thread in threads {
        let status = fs::read_to_string(thread.unwrap().path().join("status")).unwrap();
        assert!(status.contains("NoNewPrivs:\t1\n"), "{status}");
    }
}

#[test]
fn a_mode_that_admits_a_group_warns_of_a_directory_that_keeps_it_out() {
    let domain = TestDomain::new();
    fs::set_permissions(domain.folder(), Permissions::from_mode(0o700)).unwrap();
    for option in [&[][..], &["--standby"]] {
        let options = [&["--socket-mode", "660"], option].concat();
        let manager = domain.manager(&options);
        let directory = domain.folder().display();
        manager.says(&format!("the directory {directory} (mode 700)"));
        manager.says(&format!("chmod g+x {directory}"));
    }
}

/// The permissions of the socket decide who may connect.
#[test]
fn the_socket_has_the_mode_that_the_line_states() {
    for (options, mode) in [
        (&[][..], 0o600),
        (&["--socket-mode", "620"], 0o620),
        (&["--socket-mode", "666"], 0o666),
    ] {
        let domain = TestDomain::new();
        let _manager = domain.manager(options);
        let found = fs::metadata(domain.socket()).unwrap().permissions().mode();
        assert_eq!(found & 0o7777, mode);
    }
}

#[test]
fn a_line_that_cannot_be_used_is_wrong_usage() {
    let domain = TestDomain::new();
    for options in [
        &["--sessions-per-user", "0"][..],
        &["--sessions-per-user", "4", "--sessions-per-process", "5"],
        &["--socket-mode", "8"],
        &["--no-such-option"],
    ] {
        let (status, text) = domain.fails(options);
        assert_eq!(status, Some(2), "{options:?}: {text}");
    }
    assert!(domain.files().is_empty(), "{:?}", domain.files());
}

/// Nodes that break the protocol cannot fill the log of a Manager, and others leave nothing in it.
#[test]
fn a_log_has_a_few_warnings_of_a_kind_and_none_without_a_cause() {
    let domain = TestDomain::new();
    let manager = domain.manager(&[]);
    let mut node = domain.client("node");
    assert_eq!(node.nodes(), ["node"]);
    drop(domain.client("other"));
    common::eventually("the end of a session", || node.nodes() == ["node"]);
    let said = manager.stderr();
    assert!(!said.contains("WARN"), "{said}");
    for _ in 0..200 {
        let socket = SeqPacket::connect(&domain.socket()).unwrap();
        socket.send(&[IoSlice::new(b"nonsense")], &[]).unwrap();
        wait_readable(&[socket.as_fd()], Some(SOON)).unwrap();
    }
    manager.says("hung up: the node broke the protocol");
    // 16 in each period of 10 s, which the test may take several of.
    let count = manager
        .stderr()
        .matches("the node broke the protocol")
        .count();
    assert!((1..200).contains(&count), "{count}");
}
