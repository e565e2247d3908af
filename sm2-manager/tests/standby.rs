//! When a Manager ends, in whatever way, a standby takes over.

use crate::common;
use std::{fs, process, thread, time::Duration};

use crate::common::TestDomain;
use nix::sys::signal::Signal;
use sm2_io::DomainLock;
use sm2_manager::{Background, Options, Outcome, Role, Standby};
use sm2_proto::{Farewell, node::End};

//= SM2-TRN-007, SM2-SES-007 sys
#[test]
fn two_take_turns_while_each_is_killed() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let mut epochs = vec![];
    for round in 0..20 {
        let standby = domain.standby();
        let mut node = domain.client(&format!("node/{round}"));
        assert_eq!(node.server(), active.pid());
        assert!(
            node.nodes()
                .contains(&format!("sm2/standby/{}", standby.pid()))
        );
        active.kill();
        assert_eq!(node.ended(), End::Eof);
        // Several attempts: for a moment no process listens.
        let node = domain.client("next");
        assert_eq!(node.server(), standby.pid());
        epochs.push(node.epoch());
        active = standby;
    }
    epochs.sort_unstable();
    epochs.dedup();
    assert_eq!(epochs.len(), 20, "each Manager has its own epoch");
    assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
}

//= SM2-TRN-007 sys
#[test]
fn both_killed_and_one_started_later() {
    let domain = TestDomain::new();
    for option in [&[][..], &["--standby"], &["--replace"]] {
        let mut active = domain.manager(&[]);
        let mut standby = domain.standby();
        standby.kill();
        standby.wait();
        active.kill();
        active.wait();
        assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
        let later = domain.manager(option);
        assert_eq!(domain.client("node").server(), later.pid(), "{option:?}");
    }
}

//= SM2-TRN-007 sys
#[test]
fn of_several_standbys_one_serves_and_the_others_wait_for_its_end() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let mut standbys: Vec<_> = (0..4).map(|_| domain.standby()).collect();
    while !standbys.is_empty() {
        active.kill();
        let mut node = domain.client("node");
        let winner = standbys.iter().position(|it| it.pid() == node.server());
        active = standbys.remove(winner.expect("one of them"));
        common::eventually("the others to join the new Manager's domain", || {
            let nodes = node.nodes();
            let name = |pid| format!("sm2/standby/{pid}");
            let mut others = standbys.iter().map(|it| name(it.pid()));
            others.all(|name| nodes.contains(&name))
        });
    }
}

//= SM2-SES-008, SM2-TRN-007 sys
#[test]
fn a_manager_that_is_stopped_leaves_the_domain_to_its_standby() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let standby = domain.standby();
    let node = domain.client("node");
    active.signal(Signal::SIGTERM);
    assert_eq!(node.ended(), End::Peer(Farewell::ShuttingDown.code()));
    assert_eq!(active.wait(), Some(0));
    let node = domain.client("node");
    assert_eq!(node.server(), standby.pid());
}

#[test]
fn a_standby_ends_when_it_is_told_and_nobody_notices() {
    let domain = TestDomain::new();
    let active = domain.manager(&[]);
    let mut standby = domain.standby();
    let mut node = domain.client("node");
    assert_eq!(node.nodes().len(), 2);
    // A standby has no domain to hand over.
    standby.signal(Signal::SIGUSR2);
    standby.signal(Signal::SIGTERM);
    assert_eq!(standby.wait(), Some(0), "{}", standby.stderr());
    common::eventually("the standby's name to be free", || node.nodes() == ["node"]);
    assert_eq!(node.server(), active.pid());
    assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
}

/// The obstacle may disappear: a full disk, a folder that is not mounted yet.
#[test]
fn a_standby_tries_again_where_the_place_is_not_fit() {
    let domain = TestDomain::new();
    let mut active = domain.manager(&[]);
    let mut standbys = [domain.standby(), domain.standby()];
    // The socket is first created under this name.
    let obstacle = domain.folder().join("domain.sock~");
    fs::create_dir(&obstacle).unwrap();
    active.kill();
    for standby in &standbys {
        standby.says("cannot take over yet");
    }
    standbys[0].signal(Signal::SIGTERM);
    assert_eq!(standbys[0].wait(), Some(0));
    fs::remove_dir(&obstacle).unwrap();
    let node = domain.client("node");
    assert_eq!(node.server(), standbys[1].pid());
    let text = standbys[1].stderr();
    assert_eq!(text.matches("cannot take over yet").count(), 1, "{text}");
}

#[test]
fn standbys_of_one_process_have_names_of_their_own() {
    let domain = TestDomain::new();
    let active = Background::start(&domain.socket(), Options::default()).unwrap();
    let all: Vec<_> = (0..3)
        .map(|_| Background::start_or_stand_by(&domain.socket(), Options::default()).unwrap())
        .collect();
    let mut node = domain.client("node");
    let own = format!("sm2/standby/{}", process::id());
    let names = [own.clone(), format!("{own}-2"), format!("{own}-3")];
    common::eventually("three names", || {
        let nodes = node.nodes();
        names.iter().all(|name| nodes.contains(name))
    });
    let epoch = node.epoch();
    active.stop().unwrap();
    assert_ne!(domain.client("node").epoch(), epoch, "one of them serves");
    drop(all);
    assert!(domain.files().is_empty(), "{:?}", domain.files());
}

#[test]
fn a_standby_says_what_it_does() {
    let domain = TestDomain::new();
    let active = Background::start(&domain.socket(), Options::default()).unwrap();
    let mut standby = Standby::start(&domain.socket(), Options::default()).unwrap();
    assert_eq!(standby.role(), Role::StandingBy);
    let stopper = standby.stopper();
    let mut active = Some(active);
    let mut roles = vec![];
    let outcome = standby.run(|role| {
        roles.push(role);
        match active.take() {
            Some(active) => active.stop().unwrap(),
            None => stopper.stop(),
        }
    });
    assert_eq!(outcome.unwrap(), Outcome::Stopped);
    assert_eq!(roles, [Role::StandingBy, Role::Serving]);
    assert!(domain.files().is_empty(), "{:?}", domain.files());
    let alone = Standby::start(&domain.socket(), Options::default()).unwrap();
    assert_eq!(alone.role(), Role::Serving);
}

/// The Manager that holds the lock may be about to serve, or to end.
//= SM2-TRN-007 test
#[test]
fn a_standby_waits_for_a_lock_whose_holder_does_not_serve_yet() {
    let domain = TestDomain::new();
    let lock = DomainLock::acquire(&domain.socket()).unwrap();
    thread::scope(|scope| {
        let start = || Standby::start(&domain.socket(), Options::default());
        let standby = scope.spawn(start);
        // It has tried by now, or finds the lock free.
        thread::sleep(Duration::from_millis(50));
        drop(lock);
        assert_eq!(standby.join().unwrap().unwrap().role(), Role::Serving);
    });
}
