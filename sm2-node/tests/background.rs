//! The background thread: what a node does while its program does something else. Every node here has the thread,
//! whatever the environment says.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use crate::common::threads::{me, status, threads};
use crate::common::{Domain, LANES, SOON, next, until, until_exited};
use nix::libc::ENOMEM;
use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::unistd::Pid;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::{Node, NodeBuilder};
use sm2_test_support::{Scheduling, ran_alone};

impl Domain {
    fn busy(&self, name: &str) -> NodeBuilder {
        self.builder(name).background(true)
    }

    fn busy_node(&self, ring: bool, name: &str) -> Node {
        self.busy(name).ring_lane(ring).connect().unwrap()
    }
}

/// An emergency stop: nothing calls the publisher between its declaration and its only message. Once the subscriber
/// knows of the link, the message reaches it.
#[test]
fn an_idle_publisher_reaches_a_subscriber_that_joined_meanwhile() {
    for ring in LANES {
        let domain = Domain::new();
        let talker = domain.busy_node(ring, "talker");
        let publisher = talker.publisher::<str>("stop").unwrap();
        assert_eq!(publisher.publish("nobody is there").unwrap().links, 0);
        for number in 0..20 {
            // The Manager may not know yet that the last one is gone.
            let listener = domain.busy_node(ring, &format!("listener-{number}"));
            let subscriber = listener.subscriber::<str>("stop").unwrap();
            subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
            assert_eq!(publisher.publish("stop").unwrap().links, 1, "ring: {ring}");
            assert_eq!(&*next(&subscriber), "stop");
            drop((subscriber, listener));
            until(|| publisher.links().iter().all(|link| link.end.is_some()));
        }
    }
}

#[test]
fn an_idle_publisher_serves_its_latched_messages() {
    for ring in LANES {
        let domain = Domain::new();
        let server = domain.busy_node(ring, "server");
        let builder = server.publisher_builder::<[u8]>("map").latched(20);
        let publisher = builder.reliable(true).declare().unwrap();
        for number in 0..20 {
            publisher.publish(&[number]).unwrap();
        }
        for reliable in [false, true] {
            let name = if reliable { "careful" } else { "quick" };
            let node = domain.busy_node(ring, name);
            // A window of two messages: the publisher has to send the others as they are released.
            let builder = node.subscriber_builder::<[u8]>("map").max_borrowed(1);
            let subscriber = builder
                .reliable(reliable)
                .depth(if reliable { 1 } else { 20 });
            let subscriber = subscriber.declare().unwrap();
            for number in 0..20 {
                assert_eq!(&*next(&subscriber), &[number], "{name}, ring: {ring}");
            }
        }
    }
}

/// More messages than the window admits wait at the sender on the socket lane.
#[test]
fn messages_that_wait_at_the_sender_are_sent_without_a_call() {
    let domain = Domain::new();
    let talker = domain.busy_node(false, "talker");
    let publisher = talker.publisher_builder::<[u8]>("topic").depth(100);
    let publisher = publisher.declare().unwrap();
    let listener = domain.busy_node(false, "listener");
    let builder = listener.subscriber_builder::<[u8]>("topic").depth(4);
    let subscriber = builder.max_borrowed(1).declare().unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    for number in 0..100 {
        publisher.publish(&[number]).unwrap();
    }
    let mut received = Vec::new();
    while received.last() != Some(&99) {
        received.push(next(&subscriber)[0]);
    }
    let counters = publisher.counters();
    assert_eq!(counters.offered, 100);
    until(|| publisher.counters().in_flight == 0);
    assert_eq!(publisher.counters().delivered, received.len() as u64);
}

//= SM2-RES-001 test
#[test]
fn idle_nodes_find_the_next_manager_by_themselves() {
    let mut domain = Domain::new();
    let talker = domain.busy_node(true, "talker");
    let publisher = talker.publisher::<str>("topic").unwrap();
    domain.stop();
    domain.start();
    let listener = domain.busy_node(true, "listener");
    let subscriber = listener.subscriber::<str>("topic").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    assert_eq!(publisher.publish("back").unwrap().links, 1);
    assert_eq!(&*next(&subscriber), "back");
}

/// The end of a link is known although nothing reads its socket.
#[test]
fn an_idle_subscriber_learns_that_its_publisher_is_gone() {
    for ring in LANES {
        let domain = Domain::new();
        let listener = domain.busy_node(ring, "listener");
        let subscriber = listener.subscriber::<str>("topic").unwrap();
        let talker = domain.busy_node(ring, "talker");
        let publisher = talker.publisher::<str>("topic").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        publisher.publish("last words").unwrap();
        drop((publisher, talker));
        let watcher = domain.busy_node(ring, "watcher");
        // The Manager forgets the link once the subscriber has confirmed its end.
        until(|| watcher.snapshot().unwrap().links().next().is_none());
        assert_eq!(&*next(&subscriber), "last words");
    }
}

/// Calls handle the messages, and a message does not touch the timer of deadlines, so the thread sleeps through them.
//= SM2-QOS-009 test
#[test]
fn messages_do_not_wake_the_thread() {
    const MESSAGES: u16 = 1_000;
    for ring in LANES {
        let domain = Domain::new();
        // Acts on the threads of both nodes, and not on this one.
        let calls = Injector::counting();
        let installed = calls.install();
        let talker = domain.busy_node(ring, "talker");
        let listener = domain.busy_node(ring, "listener");
        drop(installed);
        let sleeps = || calls.counts().get(&Call::Poll).copied().unwrap_or(0);
        let hour = Duration::from_secs(3_600);
        let publisher = talker.publisher_builder::<[u8]>("topic").deadline(hour);
        let publisher = publisher.declare().unwrap();
        // A window that admits all messages: the thread sends those that wait for a release.
        let subscriber = listener.subscriber_builder::<[u8]>("topic").depth(MESSAGES);
        let subscriber = subscriber.deadline(hour).declare().unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
        until(|| sleeps() > 0);
        let before = sleeps();
        for number in 0..MESSAGES {
            publisher.publish(&number.to_le_bytes()).unwrap();
            next(&subscriber);
        }
        let woken = sleeps() - before;
        // On the socket lane, each of the threads reads up to 16 packets before it stops watching the link.
        assert!(woken <= 50, "{woken} of {MESSAGES} messages, ring: {ring}");
    }
}

/// A packet or a DOORBELL that found no memory is sent when there is some, though the program makes no further call.
//= SM2-TRN-013 test
#[test]
fn the_thread_sends_what_found_no_memory() {
    const LAST: u64 = u64::MAX;
    for ring in LANES {
        let domain = Domain::new();
        let talker = domain.busy_node(ring, "talker");
        let listener = domain.busy_node(ring, "listener");
        let publisher = talker.publisher::<u64>("topic").unwrap();
        let subscriber = listener.subscriber::<u64>("topic").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        let taken = AtomicU64::new(0);
        let faults = Injector::counting();
        let _installed = faults.install();
        thread::scope(|scope| {
            scope.spawn(|| {
                while taken.load(Ordering::Relaxed) != LAST {
                    taken.store(*next(&subscriber), Ordering::Relaxed);
                }
            });
            // The first message needs an ATTACH. On the ring lane, each other one needs a DOORBELL at most, and only if
            // the thread of the subscriber sleeps.
            for number in 1.. {
                faults.set((number > 1).then_some(Fault {
                    call: Call::SendMsg,
                    nth: 1,
                    times: 1,
                    errno: ENOMEM,
                }));
                publisher.publish(&number).unwrap();
                until(|| taken.load(Ordering::Relaxed) == number);
                if faults.hits() == 1 {
                    break;
                }
            }
            faults.set(None);
            publisher.publish(&LAST).unwrap();
        });
    }
}

/// Without the thread, calls that always find something to return drive the control side all the same.
#[test]
fn busy_calls_of_a_node_without_the_thread_find_new_links() {
    for ring in LANES {
        let domain = Domain::new();
        let builder = domain.busy("busy").ring_lane(ring).background(false);
        let busy = builder.connect().unwrap();
        let client = busy.client::<str, str>("service").unwrap();
        let publisher = busy.publisher::<str>("topic").unwrap();
        let listeners = ["first", "second"].map(|name| domain.busy_node(ring, name));
        let mut subscribers = Vec::new();
        for listener in &listeners {
            subscribers.push(listener.subscriber::<str>("topic").unwrap());
            until(|| publisher.publish("news").unwrap().links == subscribers.len());
        }
        assert!(client.send("nobody serves").is_err());
        let _server = listeners[0].server::<str, str>("service").unwrap();
        until(|| client.send("ask").is_ok());
    }
}

#[test]
fn the_thread_has_a_name_and_ends_with_the_node() {
    let domain = Domain::new();
    let node = domain.busy_node(true, "named");
    // The thread takes its name when it begins.
    until(|| threads("sm2:named").len() == 1);
    drop(node);
    assert!(threads("sm2:named").is_empty());
    let node = domain.busy("named").background(false).connect();
    assert!(threads("sm2:named").is_empty());
    drop(node);
}

#[test]
fn the_thread_blocks_signals() {
    let domain = Domain::new();
    let _node = domain.busy_node(true, "signals");
    until(|| threads("sm2:signals").len() == 1);
    let task = threads("sm2:signals")[0];
    // All signals but SIGKILL and SIGSTOP, which cannot be blocked, and two that the C library keeps for itself.
    assert_eq!(status(task, "SigBlk:"), "fffffffe7ffbfeff");
}

/// Scheduling is that of the thread that connected the node, so a program sets both before it connects.
#[test]
fn the_thread_inherits_priority_and_affinity() {
    let domain = Domain::new();
    thread::spawn(move || {
        let affinity = |task| status(task, "Cpus_allowed_list:");
        let all = sched_getaffinity(Pid::from_raw(0)).unwrap();
        let first = (0..CpuSet::count()).find(|&cpu| all.is_set(cpu).unwrap());
        let mut one = CpuSet::new();
        one.set(first.unwrap()).unwrap();
        sched_setaffinity(Pid::from_raw(0), &one).unwrap();
        let own = me();
        let nice = Scheduling::of_this_thread().nice + 3;
        // SAFETY: setpriority(2) takes three numbers. A thread may always lower its own priority.
        let set = unsafe { nix::libc::setpriority(nix::libc::PRIO_PROCESS, own, nice) };
        assert_eq!(set, 0);
        let _node = domain.busy_node(true, "inherits");
        until(|| threads("sm2:inherits").len() == 1);
        let task = threads("sm2:inherits")[0];
        assert_eq!(Scheduling::of_own_thread(task).nice, nice);
        assert_eq!(affinity(task), affinity(own));
    })
    .join()
    .unwrap();
}

/// The program's signal mask is as before.
#[test]
fn connecting_does_not_change_the_mask_of_the_caller() {
    let domain = Domain::new();
    thread::spawn(move || {
        let me = me();
        let before = status(me, "SigBlk:");
        let _node = domain.busy_node(true, "mask");
        assert_eq!(status(me, "SigBlk:"), before);
    })
    .join()
    .unwrap();
}

/// A child that was made by `fork(2)` drops its copy of the node. The parent's node does not notice.
#[test]
fn a_forked_child_does_not_end_the_node_of_its_parent() {
    if ran_alone(concat!(
        module_path!(),
        "::a_forked_child_does_not_end_the_node_of_its_parent"
    )) {
        return;
    }
    let domain = Domain::new();
    let node = domain.busy_node(true, "parent");
    let publisher = node.publisher::<str>("topic").unwrap();
    let subscriber = node.subscriber::<str>("topic").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    // SAFETY: the child drops its copies, which needs no lock that another thread may hold, and ends.
    match unsafe { nix::unistd::fork() }.unwrap() {
        nix::unistd::ForkResult::Child => {
            drop((node, publisher, subscriber));
            // SAFETY: ends this process without running anything else of the test program.
            unsafe { nix::libc::_exit(0) }
        }
        nix::unistd::ForkResult::Parent { child } => {
            until_exited(child);
        }
    }
    assert_eq!(publisher.publish("alive").unwrap().links, 1);
    assert_eq!(&*next(&subscriber), "alive");
    assert!(node.is_connected());
}

/// A `tracing` subscriber that panics when it is asked to.
struct Panicking;

static PANIC: AtomicBool = AtomicBool::new(false);

impl tracing::Subscriber for Panicking {
    fn enabled(&self, _: &tracing::Metadata<'_>) -> bool {
        true
    }

    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }

    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}

    fn event(&self, _: &tracing::Event<'_>) {
        let name = thread::current().name().map(str::to_owned);
        if name.as_deref() == Some("sm2:unlucky") && PANIC.swap(false, Ordering::Relaxed) {
            panic!("asked to");
        }
    }

    fn enter(&self, _: &tracing::span::Id) {}

    fn exit(&self, _: &tracing::span::Id) {}
}

/// The only code of the program that runs on the thread is its `tracing` subscriber. If it panics, the thread goes on.
#[test]
fn a_panic_of_the_programs_logger_does_not_end_the_thread() {
    tracing::subscriber::set_global_default(Panicking).unwrap();
    let mut domain = Domain::new();
    let node = domain.busy_node(true, "unlucky");
    PANIC.store(true, Ordering::Relaxed);
    // The node logs that its Manager is gone.
    domain.stop();
    until(|| !PANIC.load(Ordering::Relaxed));
    domain.start();
    let watcher = domain.busy_node(true, "watcher");
    let is_known = |name: &str| {
        let domain = watcher.snapshot().unwrap();
        domain.nodes().any(|node| node.name.as_str() == name)
    };
    until(|| is_known("unlucky"));
    drop(node);
}
