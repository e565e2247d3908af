//! A Manager takes over from another one that serves, and the domain is served without a gap.

use crate::common;
use std::{
    io::ErrorKind,
    os::unix::process::CommandExt,
    sync::atomic::{AtomicBool, Ordering},
    thread,
};

use crate::common::{Client, Program, TestDomain};
use nix::{sys::signal::Signal, unistd::geteuid};
use sm2_io::SeqPacket;
use sm2_manager::{Background, Options};
use sm2_proto::{Farewell, node::End};

/// Ends the other threads of a test, also when the test fails.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

//= SM2-RES-009 sys
#[test]
fn a_stream_of_connecting_nodes_goes_on_while_managers_replace_each_other() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let over = &AtomicBool::new(false);
    thread::scope(|scope| {
        let end = Ends(over);
        let domain = &domain;
        let nodes = move |stream: u32| {
            let mut count = 0;
            while !over.load(Ordering::Relaxed) {
                // The path names a socket at every moment.
                if let Err(error) = SeqPacket::connect(&domain.socket()) {
                    assert_ne!(error.kind(), ErrorKind::NotFound);
                }
                drop(domain.client(&format!("node/{stream}/{count}")));
                count += 1;
            }
            count
        };
        let streams = [1, 2].map(|stream| scope.spawn(move || nodes(stream)));
        for _ in 0..10 {
            let next = domain.manager(&["--replace"]);
            assert_eq!(active.wait(), Some(0), "{}", active.stderr());
            assert_eq!(domain.client("observer").server(), next.pid());
            active = next;
        }
        drop(end);
        for stream in streams {
            assert!(stream.join().unwrap() > 0);
        }
    });
    assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-RES-009, SM2-SES-008 sys
#[test]
fn sessions_end_only_once_the_next_one_serves() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let standby = domain.standby();
    let node = domain.client("node");
    active.signal(Signal::SIGUSR2);
    assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
    // The next Manager is already listening, so connecting cannot fail.
    let again = Client::attempt(&domain.socket(), "node").expect("a session at once");
    assert_eq!(again.server(), standby.pid());
    assert_eq!(active.wait(), Some(0));
    active.says("handed over");
}

//= SM2-RES-009 sys
#[test]
fn without_a_successor_the_manager_goes_on() {
    let domain = TestDomain::new();
    let active = domain.manager(&[]);
    let mut node = domain.client("node");
    // Each round takes the 2 s that a successor has to come.
    for round in 1..=if cfg!(feature = "slow") { 2 } else { 1 } {
        let said = |text: &str| active.stderr().matches(text).count() == round;
        active.signal(Signal::SIGUSR2);
        common::eventually("a hand-over", || said("handing over"));
        assert_eq!(
            node.nodes(),
            ["node"],
            "its sessions continue during the hand-over"
        );
        // A node that connects during the hand-over waits, and is served later.
        let other = Client::attempt(&domain.socket(), "other").expect("a session in the end");
        assert_eq!(other.server(), active.pid());
        common::eventually("the end of the hand-over", || said("serving again"));
        let (status, text) = domain.fails(&[]);
        assert_eq!(status, Some(1), "the Manager holds the lock again");
        assert!(text.contains("another Manager serves"), "{text}");
        drop(other);
        common::eventually("the end of the other session", || node.nodes() == ["node"]);
    }
}

//= SM2-RES-009 sys
#[test]
fn to_replace_nobody_is_to_start() {
    let domain = TestDomain::new();
    let manager = domain.manager(&["--replace"]);
    assert_eq!(domain.client("node").server(), manager.pid());
}

//= SM2-RES-009, SM2-TRN-007 sys
#[test]
fn a_manager_is_replaced_though_others_stand_by() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let mut standbys = [domain.standby(), domain.standby()];
    for _ in 0..3 {
        let next = domain.manager(&["--replace"]);
        assert_eq!(active.wait(), Some(0));
        active = next;
        assert_eq!(domain.client("node").server(), active.pid());
    }
    let mut node = domain.client("node");
    common::eventually("the standbys to join the new Manager's domain", || {
        node.nodes().len() == 3
    });
    assert!(standbys.iter_mut().all(Program::is_running));
}

#[test]
fn a_second_manager_says_what_can_be_done() {
    let domain = TestDomain::new();
    let _active = domain.manager(&[]);
    let (status, text) = domain.fails(&[]);
    assert_eq!(status, Some(1));
    for word in [
        "another Manager serves",
        "--standby",
        "--replace",
        "--domain",
    ] {
        assert!(text.contains(word), "{word} in {text}");
    }
    let (status, text) = domain.fails(&["--standby", "--replace"]);
    assert_eq!(status, Some(2), "{text}");
}

/// SIGUSR2 would kill a process that embeds its Manager.
#[test]
fn a_program_that_embeds_its_manager_is_not_asked() {
    let domain = TestDomain::new();
    let active = Background::start(&domain.socket(), Options::default()).unwrap();
    let (status, text) = domain.fails(&["--replace"]);
    assert_eq!(status, Some(1));
    assert!(text.contains("embeds its Manager"), "{text}");
    // Such a program can hand over through the API.
    let standby = domain.standby();
    active.hand_over().start();
    standby.says("serving");
    assert_eq!(domain.client("node").server(), standby.pid());
    active.stop().unwrap();
    assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-RES-009 sys
#[test]
fn a_standby_of_a_program_hands_over_and_stands_by_again() {
    let domain = TestDomain::new();
    let start = || Background::start_or_stand_by(&domain.socket(), Options::default()).unwrap();
    let (one, other) = (start(), start());
    let mut epoch = domain.client("node").epoch();
    for active in [&one, &other, &one] {
        let node = domain.client("node");
        active.hand_over().start();
        assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
        let mut node = domain.client("node");
        assert_ne!(node.epoch(), epoch);
        epoch = node.epoch();
        common::eventually("the program to stand by again", || node.nodes().len() == 2);
    }
}

/// The connection of the standby may still wait to be accepted when the hand-over begins.
//= SM2-RES-009 sys
#[test]
fn a_standby_takes_part_as_soon_as_it_has_connected() {
    for _ in 0..8 {
        let domain = TestDomain::new();
        let active = Background::start(&domain.socket(), Options::default()).unwrap();
        let epoch = domain.client("before").epoch();
        let start = || Background::start_or_stand_by(&domain.socket(), Options::default());
        let standby = start().unwrap();
        active.hand_over().start();
        let mut count = 0;
        common::eventually("the standby to serve", || {
            count += 1;
            domain.client(&format!("after/{count}")).epoch() != epoch
        });
        active.stop().unwrap();
        standby.stop().unwrap();
    }
}

#[test]
fn the_manager_of_another_user_is_not_replaced() {
    if !geteuid().is_root() {
        return sm2_test_support::skip("only root can start a process of another user");
    }
    let domain = TestDomain::new();
    let _active = domain.manager(&["--socket-mode", "666"]);
    let mut command = domain.for_a_stranger(&["--replace"]);
    command.uid(65_534).gid(65_534);
    let mut stranger = Program::start(command);
    assert_eq!(stranger.wait(), Some(1));
    let text = stranger.stderr();
    assert!(text.contains("ermission"), "{text}");
}
