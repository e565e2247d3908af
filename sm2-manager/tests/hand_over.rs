//! One Manager takes the place of another that runs, and nobody is without one.

mod common;

use std::{
    io::ErrorKind,
    os::unix::process::CommandExt,
    sync::atomic::{AtomicBool, Ordering},
    thread,
};

use common::{Client, Place, Program};
use nix::{sys::signal::Signal, unistd::geteuid};
use sm2_io::SeqPacket;
use sm2_manager::{Background, Options};
use sm2_proto::{Farewell, node::End};

//= SM2-RES-010 sys
#[test]
fn a_stream_of_connecting_nodes_goes_on_while_managers_replace_each_other() {
    let place = Place::new();
    let mut active = place.manager(&[]);
    let over = &AtomicBool::new(false);
    thread::scope(|scope| {
        let place = &place;
        let nodes = move |stream: u32| {
            let mut count = 0;
            while !over.load(Ordering::Relaxed) {
                // The path names a socket at any moment.
                if let Err(error) = SeqPacket::connect(&place.socket()) {
                    assert_ne!(error.kind(), ErrorKind::NotFound);
                }
                drop(place.client(&format!("node/{stream}/{count}")));
                count += 1;
            }
            count
        };
        let streams = [1, 2].map(|stream| scope.spawn(move || nodes(stream)));
        for _ in 0..10 {
            let next = place.manager(&["--replace"]);
            assert_eq!(active.wait(), Some(0), "{}", active.stderr());
            assert_eq!(place.client("observer").server(), next.pid());
            active = next;
        }
        over.store(true, Ordering::Relaxed);
        for stream in streams {
            assert!(stream.join().unwrap() > 0);
        }
    });
    assert_eq!(place.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-RES-010, SM2-SES-008 sys
#[test]
fn sessions_end_only_once_the_next_one_serves() {
    let place = Place::new();
    let mut active = place.manager(&[]);
    let standby = place.standby();
    let node = place.client("node");
    active.signal(Signal::SIGUSR2);
    assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
    // It listens already: connecting cannot fail.
    let again = Client::attempt(&place.socket(), "node").expect("a session at once");
    assert_eq!(again.server(), standby.pid());
    assert_eq!(active.wait(), Some(0));
    active.says("handed over");
}

//= SM2-RES-010 sys
#[test]
fn without_a_successor_the_manager_goes_on() {
    let place = Place::new();
    let active = place.manager(&[]);
    let mut node = place.client("node");
    for round in 1..=2 {
        let said = |text: &str| active.stderr().matches(text).count() == round;
        active.signal(Signal::SIGUSR2);
        common::eventually("a hand-over", || said("handing over"));
        assert_eq!(node.nodes(), ["node"], "its sessions go on meanwhile");
        // Whoever comes meanwhile waits, and is served.
        let other = Client::attempt(&place.socket(), "other").expect("a session in the end");
        assert_eq!(other.server(), active.pid());
        common::eventually("its end", || said("going on"));
        let (status, text) = place.fails(&[]);
        assert_eq!(status, Some(1), "it has the lock again");
        assert!(text.contains("another Manager serves"), "{text}");
        drop(other);
        common::eventually("the other's end", || node.nodes() == ["node"]);
    }
}

//= SM2-RES-010 sys
#[test]
fn to_replace_nobody_is_to_start() {
    let place = Place::new();
    let manager = place.manager(&["--replace"]);
    assert_eq!(place.client("node").server(), manager.pid());
}

//= SM2-RES-010, SM2-TRN-008 sys
#[test]
fn a_manager_is_replaced_though_others_stand_by() {
    let place = Place::new();
    let mut active = place.manager(&[]);
    let mut standbys = [place.standby(), place.standby()];
    for _ in 0..3 {
        let next = place.manager(&["--replace"]);
        assert_eq!(active.wait(), Some(0));
        active = next;
        assert_eq!(place.client("node").server(), active.pid());
    }
    let mut node = place.client("node");
    common::eventually("the standbys to stand by for it", || {
        node.nodes().len() == 3
    });
    assert!(standbys.iter_mut().all(Program::is_running));
}

#[test]
fn a_second_manager_says_what_can_be_done() {
    let place = Place::new();
    let _active = place.manager(&[]);
    let (status, text) = place.fails(&[]);
    assert_eq!(status, Some(1));
    for word in [
        "another Manager serves",
        "--standby",
        "--replace",
        "--domain",
    ] {
        assert!(text.contains(word), "{word} in {text}");
    }
    let (status, text) = place.fails(&["--standby", "--replace"]);
    assert_eq!(status, Some(2), "{text}");
}

/// The signal would end this process, which embeds the Manager.
#[test]
fn a_program_that_embeds_its_manager_is_not_asked() {
    let place = Place::new();
    let active = Background::start(&place.socket(), Options::default()).unwrap();
    let (status, text) = place.fails(&["--replace"]);
    assert_eq!(status, Some(1));
    assert!(text.contains("embeds its Manager"), "{text}");
    // But it can do it by itself.
    let standby = place.standby();
    active.hand_over().start();
    standby.says("serving");
    assert_eq!(place.client("node").server(), standby.pid());
    active.stop().unwrap();
    assert_eq!(place.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-RES-010 sys
#[test]
fn a_standby_of_a_program_hands_over_and_stands_by_again() {
    let place = Place::new();
    let start = || Background::start_or_stand_by(&place.socket(), Options::default()).unwrap();
    let (one, other) = (start(), start());
    let mut epoch = place.client("node").epoch();
    for active in [&one, &other, &one] {
        let node = place.client("node");
        active.hand_over().start();
        assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
        let mut node = place.client("node");
        assert_ne!(node.epoch(), epoch);
        epoch = node.epoch();
        common::eventually("it to stand by again", || node.nodes().len() == 2);
    }
}

#[test]
fn the_manager_of_another_user_is_not_replaced() {
    if !geteuid().is_root() {
        println!("skipped: only root can be somebody else");
        return;
    }
    let place = Place::new();
    let _active = place.manager(&["--socket-mode", "666"]);
    let mut command = place.for_a_stranger(&["--replace"]);
    command.uid(65_534).gid(65_534);
    let mut stranger = Program::start(command);
    assert_eq!(stranger.wait(), Some(1));
    let text = stranger.stderr();
    assert!(text.contains("ermission"), "{text}");
}
