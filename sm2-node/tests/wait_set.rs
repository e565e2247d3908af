//! Wait sets: with and without the background thread, on both lanes.

mod common;

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use common::threads::{sleeps, while_asleep};
use common::{DRIVEN, Domain, SOON, meet, until};
use sm2_node::wait_set::{Cause, Interest, Readiness, Ready};
use sm2_node::{
    CallError, Event, Instant, MissedTicks, Node, NodeBuilder, Shutdown, Timer, WaitError, WaitSet,
    now,
};

/// Longer than a test may take.
const LONG: Duration = Duration::from_secs(3_600);

struct Fixture {
    domain: Domain,
    background: bool,
    ring: bool,
}

impl Fixture {
    fn each(test: impl Fn(&Self)) {
        for (background, ring) in DRIVEN {
            test(&Self {
                domain: Domain::new(),
                background,
                ring,
            });
        }
    }

    fn builder(&self, name: &str) -> NodeBuilder {
        let builder = Node::builder(name).socket(self.domain.socket());
        builder.background(self.background).ring_lane(self.ring)
    }

    fn node(&self, name: &str) -> Node {
        self.builder(name).connect().unwrap()
    }

    /// A node that lives without calls of the test.
    fn peer(&self, name: &str) -> Node {
        self.builder(name).background(true).connect().unwrap()
    }
}

fn next<T: Clone>(set: &mut WaitSet<'_, T>) -> Ready<T> {
    set.wait_timeout(SOON).unwrap().expect("a source is ready")
}

/// Whether nothing is ready.
fn is_quiet<T: Clone>(set: &mut WaitSet<'_, T>) -> bool {
    set.try_wait().unwrap().is_none()
}

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
        let joined = node.publisher::<u64>("other").unwrap();
        let events = joined.events();
        let (ours, mut theirs) = UnixStream::pair().unwrap();

        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, Tag::Topic).unwrap();
        set.add(&server, Tag::Service).unwrap();
        set.add(&events, Tag::Joined).unwrap();
        set.add_timer(Timer::every(Duration::from_millis(1)), Tag::Tick);
        set.add_descriptor(&ours, Interest::Readable, Tag::Pipe)
            .unwrap();

        let peer = it.peer("peer");
        let triple = peer.server::<u64, u64>("triple").unwrap();
        let publisher = peer.publisher::<u64>("topic").unwrap();
        let _other = peer.subscriber::<u64>("other").unwrap();
        let peers_client = peer.client::<u64, u64>("double").unwrap();
        until(|| {
            let open =
                |links: Vec<sm2_node::diagnostics::LinkStatus>| links.iter().any(|it| it.open);
            open(client.links()) && open(peers_client.links()) && open(publisher.links())
        });
        let mut call = client.send(&7).unwrap();
        set.add(&call, Tag::Call).unwrap();
        publisher.publish(&1).unwrap();
        let mut doubled = peers_client.send(&21).unwrap();
        theirs.write_all(&[3]).unwrap();
        thread::scope(|scope| {
            scope.spawn(|| {
                let request = triple.recv_timeout(SOON).unwrap().expect("a request");
                let tripled = *request * 3;
                request.reply(&tripled).unwrap();
            });
            let (mut seen, mut ticks) = (Vec::new(), 0);
            while seen.len() < 5 || ticks < 3 {
                let ready = next(&mut set);
                match ready.tag {
                    Tag::Topic => match subscriber.try_recv().unwrap() {
                        Some(sample) => assert_eq!(*sample, 1),
                        None => continue,
                    },
                    Tag::Service => match server.try_recv().unwrap() {
                        Some(request) => {
                            let twice = *request * 2;
                            request.reply(&twice).unwrap();
                        }
                        None => continue,
                    },
                    Tag::Call => {
                        assert_eq!(*call.try_wait().unwrap().expect("the reply"), 21);
                    }
                    Tag::Joined => {
                        let event = events.try_next().unwrap().expect("an event");
                        assert!(
                            matches!(event, Event::Joined { peer } if peer.name.as_str() == "peer")
                        );
                    }
                    Tag::Tick => {
                        assert!(matches!(ready.cause, Cause::Tick(tick) if tick.due <= now()));
                        ticks += 1;
                        continue;
                    }
                    Tag::Pipe => {
                        let cause = Cause::Descriptor(Readiness {
                            readable: true,
                            writable: false,
                        });
                        assert_eq!(ready.cause, cause);
                        assert_eq!((&ours).read(&mut [0]).unwrap(), 1);
                    }
                }
                assert!(!seen.contains(&ready.tag), "{:?} twice", ready.tag);
                seen.push(ready.tag);
            }
        });
        until(|| {
            // The robot's node may have no thread that sends the reply.
            assert!(set.try_wait().unwrap().is_none_or(|it| it.tag != Tag::Pipe));
            doubled
                .try_wait()
                .unwrap()
                .is_some_and(|reply| *reply == 42)
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
fn a_subscriber_is_ready_until_nothing_is_left() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        // Before it is added.
        publisher.publish(&0).unwrap();
        let mut set = WaitSet::new().unwrap();
        let key = set.add(&subscriber, ()).unwrap();
        for round in 0..3 {
            for number in 1..=3 {
                publisher.publish(&(round * 3 + number)).unwrap();
            }
            let last = round * 3 + 3;
            loop {
                assert_eq!(next(&mut set).key, key);
                let sample = subscriber.try_recv().unwrap().expect("a message");
                if *sample == last {
                    break;
                }
            }
            assert!(is_quiet(&mut set));
        }
    });
}

#[test]
fn a_source_that_is_removed_while_it_is_ready_is_not_reported() {
    Fixture::each(|it| {
        let node = it.node("listener");
        let subscribers = ["a", "b"].map(|topic| node.subscriber::<u64>(topic).unwrap());
        let talker = it.peer("talker");
        let publishers = ["a", "b"].map(|topic| talker.publisher::<u64>(topic).unwrap());
        let mut set = WaitSet::new().unwrap();
        let keys = [0, 1].map(|at| set.add(&subscribers[at], at).unwrap());
        for (publisher, subscriber) in publishers.iter().zip(&subscribers) {
            meet(publisher, &[subscriber]);
            publisher.publish(&1).unwrap();
        }
        // Both are found together.
        let first = next(&mut set).tag;
        let other = 1 - first;
        assert!(set.remove(keys[other]));
        assert!(!set.remove(keys[other]));
        assert!(subscribers[first].try_recv().unwrap().is_some());
        assert!(is_quiet(&mut set));
        assert_eq!(set.len(), 1);
        // It can come back.
        let again = set.add(&subscribers[other], other).unwrap();
        assert_ne!(again, keys[other]);
        assert_eq!(next(&mut set).tag, other);
        assert!(subscribers[other].try_recv().unwrap().is_some());
    });
}

#[test]
fn a_subscriber_that_was_dropped_is_never_ready() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        let mut set = WaitSet::new().unwrap();
        let key = set.add(&subscriber, ()).unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish(&1).unwrap();
        assert_eq!(next(&mut set).key, key);
        drop(subscriber);
        assert!(is_quiet(&mut set));
        assert!(set.remove(key));
    });
}

#[test]
fn calls_are_reported_once_with_a_reply_a_failure_or_their_deadline() {
    Fixture::each(|it| {
        let server = it.peer("server").server::<u64, u64>("service").unwrap();
        let client = it.node("client").client::<u64, u64>("service").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        let mut calls = [1, 2].map(|number| client.send(&number).unwrap());
        let mut late = client.send_timeout(&3, Duration::from_millis(1)).unwrap();
        let forgotten = client.send(&4).unwrap();
        let mut set = WaitSet::new().unwrap();
        for (at, call) in calls.iter().enumerate() {
            set.add(call, at).unwrap();
        }
        set.add(&late, 2).unwrap();
        set.add(&forgotten, 3).unwrap();
        // Nobody has replied.
        assert_eq!(next(&mut set).tag, 2);
        let ended = late.try_wait().map(drop);
        assert!(
            matches!(ended, Err(CallError::DeadlineExceeded { .. })),
            "{ended:?}"
        );
        assert!(is_quiet(&mut set));
        drop(forgotten);
        assert!(is_quiet(&mut set));
        let mut requests = Vec::new();
        while requests.len() < 2 {
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            if *request <= 2 {
                requests.push(request);
            }
        }
        requests.pop().unwrap().reply(&20).unwrap();
        assert_eq!(next(&mut set).tag, 1);
        assert_eq!(*calls[1].try_wait().unwrap().expect("a reply"), 20);
        assert!(is_quiet(&mut set));
        // The server fails the other call as it ends.
        drop(requests);
        drop(server);
        assert_eq!(next(&mut set).tag, 0);
        assert!(calls[0].try_wait().is_err());
        assert_eq!(set.len(), 1, "only the forgotten call is left");
    });
}

#[test]
fn timers_skip_or_repeat_missed_ticks_and_leave_the_set_after_the_last() {
    // Its fourth tick has passed, and the fifth does not come during this test.
    let long = Duration::from_nanos(now().0 / 4);
    let mut set = WaitSet::new().unwrap();
    set.add_timer(Timer::starting_at(Instant(0), long), "skip");
    let Cause::Tick(tick) = next(&mut set).cause else {
        panic!("not a tick");
    };
    assert_eq!((tick.number, tick.missed), (4, 3));
    assert!(is_quiet(&mut set));
    let burst = Timer::starting_at(Instant(0), long).missed_ticks(MissedTicks::Burst);
    let key = set.add_timer(burst, "burst");
    for number in 1..=4 {
        let Ready { tag, cause, .. } = next(&mut set);
        assert_eq!(tag, "burst");
        assert!(matches!(cause, Cause::Tick(tick) if tick.number == number));
    }
    assert!(is_quiet(&mut set));
    assert!(set.remove(key));
    set.add_timer(Timer::once(Duration::ZERO), "once");
    assert_eq!(next(&mut set).tag, "once");
    assert_eq!(set.len(), 1);
    assert!(is_quiet(&mut set));
}

#[test]
fn a_wait_ends_after_its_time_without_a_source() {
    let mut set = WaitSet::<()>::new().unwrap();
    assert!(set.is_empty());
    set.add_timer(Timer::every(LONG), ());
    let waited = set.wait_timeout(Duration::from_millis(1)).unwrap();
    assert!(waited.is_none());
}

#[test]
fn descriptors_are_borrowed_or_owned_with_their_interest() {
    let (borrowed, mut peer) = UnixStream::pair().unwrap();
    let (owned, other) = UnixStream::pair().unwrap();
    let mut set = WaitSet::new().unwrap();
    let error = set.add_descriptor(
        std::fs::File::open("Cargo.toml").unwrap(),
        Interest::Readable,
        0,
    );
    assert_eq!(
        error.unwrap_err().kind(),
        std::io::ErrorKind::PermissionDenied
    );
    let key = set
        .add_descriptor(&borrowed, Interest::Readable, 1)
        .unwrap();
    let error = set.add_descriptor(&borrowed, Interest::Readable, 1);
    assert_eq!(error.unwrap_err().kind(), std::io::ErrorKind::AlreadyExists);
    assert!(is_quiet(&mut set));
    let writable = set.add_descriptor(owned, Interest::Writable, 2).unwrap();
    // Level-triggered: as long as it is ready.
    for _ in 0..3 {
        let ready = next(&mut set);
        let cause = Cause::Descriptor(Readiness {
            readable: false,
            writable: true,
        });
        assert_eq!((ready.tag, ready.cause), (2, cause));
    }
    assert!(set.remove(writable));
    // The set owned it.
    assert_eq!((&other).read(&mut [0]).unwrap(), 0);
    peer.write_all(&[1]).unwrap();
    assert_eq!(next(&mut set).key, key);
    assert_eq!((&borrowed).read(&mut [0]).unwrap(), 1);
    assert!(is_quiet(&mut set));
    drop(peer);
    assert!(set.remove(key));
    assert!(is_quiet(&mut set));
    let again = set
        .add_descriptor(&borrowed, Interest::Readable, 3)
        .unwrap();
    let ready = next(&mut set);
    assert_eq!((ready.tag, ready.key), (3, again));
    assert!(matches!(
        ready.cause,
        Cause::Descriptor(Readiness { readable: true, .. })
    ));
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
        let ended = while_asleep(
            || set.wait(),
            |task| {
                let before = sleeps(task);
                for number in 0..1_000 {
                    publisher.publish(&number).unwrap();
                    assert_eq!(
                        *busy.recv_timeout(SOON).unwrap().expect("a message"),
                        number
                    );
                }
                let woken = sleeps(task) - before;
                // The links of its own subscribers may have been new.
                assert!(woken <= 6, "{woken} of 1,000 messages");
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
            for number in 1..=2_000 {
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
            nix::unistd::ForkResult::Parent { child } => {
                nix::sys::wait::waitpid(child, None).unwrap();
            }
        }
        next(&mut set);
        assert!(subscriber.try_recv().unwrap().is_some());
    });
}
