//! The boundary between users: messages across it are sealed.

// Shows MGR-SEAL (test, full).

use std::{
    fs::{self, Permissions},
    os::{
        fd::AsFd,
        unix::{fs::PermissionsExt, process::CommandExt},
    },
    process::Command,
};

use nix::unistd::geteuid;
use sm2_proto::ViolationKind;
use sm2_tests::{
    actor::Actor,
    control::{self, Qos},
    domain::TempDomain,
    link::{attach, role},
    memory,
    process::actor,
    raw::RawNode,
};
/// The user `nobody`.
const STRANGER: u32 = 65_534;

/// A domain that other users may connect to, or `None` if this process is not root: only root can
/// run as two users.
fn open_domain() -> Option<TempDomain> {
    if !geteuid().is_root() {
        sm2_test_support::skip("only root can start processes of another user");
        return None;
    }
    let domain = TempDomain::new();
    let passable = Permissions::from_mode(0o711);
    fs::set_permissions(domain.folder(), passable).expect("chmod");
    Some(domain)
}

/// A node of another user. Its program is a copy that this user may execute.
fn stranger(domain: &TempDomain) -> Actor {
    let program = domain.folder().join("actor");
    if !program.exists() {
        // Copied by another process. If this process wrote the file, a child that another thread is
        // just starting would hold it open for writing, and the kernel does not execute such a
        // file.
        let mut copy = Command::new("cp");
        copy.arg(actor("node").get_program()).arg(&program);
        assert!(copy.status().expect("cp").success());
    }
    let mut command = Command::new(program);
    command.arg("node").uid(STRANGER).gid(STRANGER);
    Actor::start_as(command, &domain.socket(), "stranger")
}

/// Exchanges large messages between two users in both directions, and checks whether their links
/// are sealed.
fn exchange(options: &[&str], sealed: bool) {
    let Some(domain) = open_domain() else {
        return;
    };
    let options = [&["--socket-mode", "666"], options].concat();
    let _manager = domain.manager_with(&options);
    let mut ours = Actor::start(&domain.socket(), "ours");
    let mut theirs = stranger(&domain);
    for node in [&mut ours, &mut theirs] {
        let name = node.name().to_owned();
        node.tell(&format!("pub out {name} reliable_ms=60000"));
    }
    ours.tell("sub in stranger reliable");
    theirs.tell("sub in ours reliable");
    for (from, to) in [(0, 1), (1, 0)] {
        let pair = [&mut ours, &mut theirs];
        let [one, other] = pair;
        let (from, to) = if from < to {
            (one, other)
        } else {
            (other, one)
        };
        from.tell("wait out 1");
        for size in [0, 8, 5_000, 3_000_000] {
            from.tell(&format!("publish out 1 {size}"));
            let taken = to.tell("take in 1");
            assert!(taken.ends_with("lost=0 damaged=0"), "{size}: {taken}");
        }
        let links = from.tell("counters out");
        assert!(links.contains(&format!("sealed={sealed}")), "{links}");
    }
}

//= SM2-MAT-003, SM2-TRN-006 sys
#[test]
fn links_between_users_are_sealed() {
    exchange(&[], true);
}

//= SM2-MAT-003 sys
#[test]
fn a_domain_may_waive_the_boundary() {
    exchange(&["--waive-user-boundary", "true"], false);
}

//= SM2-PAY-001 sys
#[test]
fn a_segment_for_another_user_ends_the_link() {
    let Some(domain) = open_domain() else {
        return;
    };
    let _manager = domain.manager_with(&["--socket-mode", "666"]);
    let mut theirs = stranger(&domain);
    theirs.tell("sub t t");
    let ours = RawNode::welcomed(&domain.socket(), "ours");
    ours.declare(1, &control::publisher("t", Qos::PLAIN));
    let link = ours.linked();
    assert!(link.sealed);
    link.open(role::SENDER, 0);
    let segment = memory::segment(4096);
    link.end.send_fds(attach(1, 4096, 1), &[segment.as_fd()]);
    assert_eq!(link.closed(), Some(ViolationKind::NotSealed.code().0));
}

//= SM2-MAT-003 sys
#[test]
fn a_domain_may_seal_everything() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--seal-all", "true"]);
    let node = manager.node("n");
    node.declare(1, &control::publisher("t", Qos::PLAIN));
    node.declare(2, &control::subscriber("t", Qos::PLAIN));
    assert!(node.linked().sealed && node.linked().sealed);
}
