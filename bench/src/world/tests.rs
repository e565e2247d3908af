use std::{fs, path::Path, time::Duration};

use super::{Failure, World, core, tail};
use crate::{
    job::{Cores, ProcessEvent, Role},
    peers::{PEERS, catalogue::find},
};

/// The processes of these worlds are test programs, which do not know the roles: they end at once.
fn started() -> (World, super::ProcessId) {
    let mut world = World::new(find("raw-futex").unwrap()).unwrap();
    let role = Role::Node {
        number: 0,
        count: 2,
    };
    let process = world.start("node", role).unwrap();
    (world, process)
}

#[test]
fn who_ends_without_a_word_is_reported_at_once() {
    let (mut world, process) = started();
    let failure = world.ready(process).unwrap_err();
    assert!(matches!(failure, Failure::Ended { .. }), "{failure}");
    assert!(
        failure
            .to_string()
            .starts_with("node ended without a report")
    );
}

#[test]
fn who_says_nothing_is_not_waited_for_any_longer_than_said() {
    let (mut world, process) = started();
    // Its end has not been heard of yet, or has: either is a failure, and nothing hangs.
    let failure = world
        .next_event(process, "speak", Duration::ZERO)
        .unwrap_err();
    assert!(matches!(
        failure,
        Failure::TimedOut { .. } | Failure::Ended { .. }
    ));
}

#[test]
fn a_daemon_that_does_not_come_up_is_a_failure_of_the_case() {
    assert!(PEERS[0].daemon);
    let failure = World::new(&PEERS[0]).err().unwrap();
    assert!(failure.to_string().starts_with("daemon"));
}

#[test]
fn nothing_is_left_of_a_world() {
    let (world, process) = started();
    let dir = world.dir.path().to_owned();
    let pid = world.processes[process.0].child.id();
    assert!(dir.exists());
    drop(world);
    assert!(!dir.exists());
    assert!(!Path::new(&format!("/proc/{pid}")).exists());
}

#[test]
fn what_is_said_otherwise_than_expected_is_told_with_what_was() {
    let (world, process) = started();
    let failure = world.unexpected(process, ProcessEvent::Measured, "set up");
    assert_eq!(
        failure.to_string(),
        "node sent Measured when it was expected to set up"
    );
}

#[test]
fn processes_are_put_where_they_should_be() {
    let places = |cores| [0, 1, 2].map(|number| core(cores, number, 2));
    assert_eq!(places(Cores::Free), [None; 3]);
    assert_eq!(places(Cores::Apart), [Some(0), Some(1), Some(0)]);
    assert_eq!(places(Cores::Together), [Some(0); 3]);
}

#[test]
fn the_last_line_that_says_something_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("stderr");
    fs::write(&path, "first\n  second  \n\n").unwrap();
    assert_eq!(tail(&path), "second");
    assert_eq!(tail(&dir.path().join("none")), "");
}
