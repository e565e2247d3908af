//! Wait sets: with and without the background thread, on both lanes.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use crate::common::fixture::{Fixture, Peer};
use crate::common::threads::while_asleep;
use crate::common::wait::{LONG, is_quiet, next};
use crate::common::{SOON, meet, until, until_exited};
use sm2_io::fault::{Call, Injector};
use sm2_node::wait_set::{Cause, Interest};
use sm2_node::{Event, Shutdown, Timer, WaitError, WaitSet, now};
use sm2_test_support::ran_alone;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Tag {
    Topic,
    Service,
    Call,
    Joined,
    Tick,
    Pipe,
}

/// All kinds of sources in one set, which is the only loop of its nodes.
#[test]
fn all_kinds_of_sources_are_reported() {
    Fixture::each(|it| {
        let node = it.node("robot");
        let subscriber = node.subscriber::<u64>("topic").unwrap();
        let server = node.server::<u64, u64>("double").unwrap();
        let client = node.client::<u64, u64>("triple").unwrap();
        let other = node.publisher::<u64>("other").unwrap();
        let (events, mut seen, mut ticks) = (other.events(), Vec::new(), 0);
        let (ours, mut theirs) = UnixStream::pair().unwrap();

        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, Tag::Topic).unwrap();
        set.add(&server, Tag::Service).unwrap();
        set.add(&events, Tag::Joined).unwrap();
        set.add_timer(Timer::every(Duration::from_millis(1)), Tag::Tick);
        set.add_descriptor(&ours, Interest::Readable, Tag::Pipe)
            .unwrap();

        // Other threads drive nothing of a node without a background thread: the set does.
        let peer = thread::scope(|scope| {
            let peer = scope.spawn(|| Peer::new(it));
            while !peer.is_finished() || client.links().iter().all(|link| !link.open) {
                assert!(set.try_wait().unwrap().is_none_or(|it| it.tag != Tag::Pipe));
            }
            peer.join().unwrap()
        });
        let mut call = client.send(&7).unwrap();
        set.add(&call, Tag::Call).unwrap();
        peer.topic.publish(&1).unwrap();
        let mut doubled = peer.double.send(&21).unwrap();
        theirs.write_all(&[3]).unwrap();
        thread::scope(|scope| {
            scope.spawn(|| peer.triple_once());
            while seen.len() < 5 || ticks < 3 {
                let ready = next(&mut set);
                match ready.tag {
                    Tag::Topic => assert_eq!(*subscriber.try_recv().unwrap().unwrap(), 1),
                    Tag::Service => {
                        let request = server.try_recv().unwrap().expect("a request");
                        let twice = *request * 2;
                        request.reply(&twice).unwrap();
                    }
                    Tag::Call => {
                        assert_eq!(*call.try_wait().unwrap().expect("the reply"), 21);
                    }
                    Tag::Joined => {
                        let event = events.try_next().unwrap();
                        assert!(matches!(event, Some(Event::Joined { .. })), "{event:?}");
                    }
                    Tag::Tick => {
                        ticks +=
                            u64::from(matches!(ready.cause, Cause::Tick(it) if it.due <= now()));
                        continue;
                    }
                    Tag::Pipe => {
                        assert!(matches!(ready.cause, Cause::Descriptor(it) if it.readable));
                        assert_eq!((&ours).read(&mut [0]).unwrap(), 1);
                    }
                }
                assert!(!seen.contains(&ready.tag), "{:?} twice", ready.tag);
                seen.push(ready.tag);
            }
        });
        until(|| {
            set.try_wait().unwrap();
            let reply = doubled.try_wait().unwrap();
            reply.is_some_and(|reply| *reply == 42)
        });
    });
}

/// A node without a background thread has no other loop: the set makes its links.
#[test]
fn a_wait_drives_the_nodes_of_its_sources_and_others() {
    Fixture::each(|it| {
        let (node, quiet) = (it.node("node"), it.node("quiet"));
        let subscriber = node.subscriber::<str>("topic").unwrap();
        let publisher = quiet.publisher_builder::<str>("latched").latched(1);
        let publisher = publisher.declare().unwrap();
        publisher.publish("kept").unwrap();
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, ()).unwrap();
        set.drive(&quiet).unwrap();
        thread::scope(|scope| {
            scope.spawn(|| {
                let peer = it.peer("peer");
                let latched = peer.subscriber::<str>("latched").unwrap();
                let kept = latched.recv_timeout(SOON).unwrap().expect("the kept one");
                let publisher = peer.publisher::<str>("topic").unwrap();
                publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
                publisher.publish(&kept).unwrap();
                publisher.flush_timeout(SOON).unwrap();
            });
            next(&mut set);
            assert_eq!(&*subscriber.try_recv().unwrap().expect("a message"), "kept");
        });
    });
}

#[test]
fn a_shutdown_ends_a_wait_but_not_the_rest_of_the_work() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        let shutdown = Shutdown::new().unwrap();
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, ()).unwrap();
        set.add_timer(Timer::every(LONG), ());
        set.end_with(&shutdown).unwrap();
        let ended = while_asleep(|| set.wait(), |_| shutdown.request());
        assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
        meet(&publisher, &[&subscriber]);
        publisher.publish(&1).unwrap();
        let ended = set.wait_timeout(SOON);
        assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
        until(|| set.try_wait().unwrap().is_some());
        assert!(subscriber.try_recv().unwrap().is_some());
    });
}

/// A thread that waits in a set of many sources sleeps through the messages of all others.
#[test]
fn an_idle_set_does_not_wake_up() {
    Fixture::each(|it| {
        let node = it.node("listener");
        let names = ["a", "b", "c", "d", "e", "f"];
        let quiet = names.map(|name| node.subscriber::<u64>(name).unwrap());
        let busy = node.subscriber::<u64>("busy").unwrap();
        let talker = it.peer("talker");
        let _publishers = names.map(|name| talker.publisher::<u64>(name).unwrap());
        let publisher = talker.publisher::<u64>("busy").unwrap();
        for subscriber in &quiet {
            subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
        }
        meet(&publisher, &[&busy]);
        let shutdown = Shutdown::new().unwrap();
        let mut set = WaitSet::new().unwrap();
        for subscriber in &quiet {
            set.add(subscriber, ()).unwrap();
        }
        set.add_timer(Timer::every(LONG), ());
        set.end_with(&shutdown).unwrap();
        let calls = Injector::counting();
        let waits = || calls.counts().get(&Call::EpollWait).copied().unwrap_or(0);
        let ended = while_asleep(
            || {
                let _installed = calls.install();
                set.wait()
            },
            |_| {
                until(|| waits() > 0);
                let before = waits();
                for number in 0..1_000 {
                    publisher.publish(&number).unwrap();
                    assert_eq!(
                        *busy.recv_timeout(SOON).unwrap().expect("a message"),
                        number
                    );
                }
                let woken = waits() - before;
                // The links of its own subscribers may have been new: a few events of each, however late they come.
                assert!(woken <= 24, "{woken} of 1,000 messages");
                shutdown.request();
            },
        );
        assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
    });
}

/// Pauses for a duration that differs from round to round, so that the other thread is met before it waits, while it is
/// about to wait, and while it waits.
fn dawdle(round: u64) {
    let spins = [0, 10, 100, 1_000, 10_000][(round % 5) as usize];
    (0..spins * (1 + round % 3)).for_each(|_| std::hint::spin_loop());
}

/// The messages of a test that looks for a lost wake-up.
const MESSAGES: u64 = if cfg!(feature = "slow") { 2_000 } else { 200 };

/// Each message is published when the one before was taken, so a lost wake-up ends everything. Another thread looks at
/// the same subscriber now and then, and may read the socket or take the message.
#[test]
fn no_wake_up_is_lost() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let (taken, done) = (AtomicU64::new(0), AtomicBool::new(false));
        let take = || {
            while let Some(sample) = subscriber.try_recv().unwrap() {
                assert_eq!(*sample, 1 + taken.fetch_add(1, Ordering::AcqRel));
            }
        };
        let shutdown = Shutdown::new().unwrap();
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, ()).unwrap();
        set.end_with(&shutdown).unwrap();
        thread::scope(|scope| {
            scope.spawn(|| {
                while let Ok(Some(())) = set.wait_timeout(LONG).map(|it| it.map(|_| ())) {
                    take();
                }
            });
            scope.spawn(|| {
                for round in 0.. {
                    if done.load(Ordering::Acquire) {
                        break;
                    }
                    dawdle(round);
                    if round % 3 == 0 {
                        subscriber.links();
                    }
                    thread::yield_now();
                }
            });
            for number in 1..=MESSAGES {
                dawdle(number);
                publisher.publish(&number).unwrap();
                until(|| taken.load(Ordering::Acquire) == number);
            }
            done.store(true, Ordering::Release);
            shutdown.request();
        });
    });
}

#[test]
fn a_set_can_move_to_another_thread() {
    fn is_send<T: Send>() {}
    is_send::<WaitSet<'static, Tag>>();
    let mut set = WaitSet::new().unwrap();
    set.add_timer(Timer::once(Duration::ZERO), 7);
    let tag = thread::spawn(move || next(&mut set).tag).join().unwrap();
    assert_eq!(tag, 7);
}

/// The copy of the set in a child leaves the set of the parent as it is.
#[test]
fn a_forked_child_can_drop_its_copy() {
    if ran_alone(concat!(
        module_path!(),
        "::a_forked_child_can_drop_its_copy"
    )) {
        return;
    }
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, ()).unwrap();
        assert!(is_quiet(&mut set));
        publisher.publish(&1).unwrap();
        // Another call reads the socket, and signals the waker of the set: a descriptor that the child has, too.
        subscriber.links();
        // SAFETY: the child drops its copies, which needs no lock that another thread may hold, and ends.
        match unsafe { nix::unistd::fork() }.unwrap() {
            nix::unistd::ForkResult::Child => {
                drop((set, subscriber, publisher));
                // SAFETY: ends this process without running anything else of the test program.
                unsafe { nix::libc::_exit(0) }
            }
            nix::unistd::ForkResult::Parent { child } => until_exited(child),
        }
        next(&mut set);
        assert!(subscriber.try_recv().unwrap().is_some());
    });
}
