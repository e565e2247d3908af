//! The system calls of a wait in a set: their number, and a lack of memory for them.

use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::wait::next;
use crate::common::{Domain, SOON, meet};
use nix::libc::{EBADF, ENOMEM};
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::{Publisher, Subscriber, Timer, WaitSet};

/// The system calls of a wait that finds a message, and of one that finds nothing. The least of several rounds: an
/// event that is left from before may add some.
fn least_calls(set: &mut WaitSet<'_, ()>, pair: (&Publisher<u64>, &Subscriber<u64>)) -> (u64, u64) {
    let (publisher, subscriber) = pair;
    let injector = Injector::counting();
    let waits = || {
        injector
            .counts()
            .get(&Call::EpollWait)
            .copied()
            .unwrap_or(0)
    };
    let mut least = (u64::MAX, u64::MAX);
    for number in 0..20 {
        while set.try_wait().unwrap().is_some() {}
        publisher.publish(&number).unwrap();
        injector.set(None);
        let installed = injector.install();
        next(set);
        least.0 = least.0.min(waits());
        assert_eq!(*subscriber.try_recv().unwrap().expect("a message"), number);
        injector.set(None);
        assert!(set.try_wait().unwrap().is_none());
        least.1 = least.1.min(waits());
        drop(installed);
    }
    least
}

/// One call finds a message among many sources, and one reads the sockets of its subscriber. At the end of the
/// messages, there is no call but the one that finds nothing.
#[test]
fn a_wait_costs_the_same_for_any_number_of_sources() {
    let domain = Domain::new();
    let connect = |name| domain.builder(name).background(true).connect().unwrap();
    let (listener, talker) = (connect("listener"), connect("talker"));
    let names: Vec<String> = (0..20).map(|number| format!("topic{number}")).collect();
    let subscribers = names.iter().map(|name| listener.subscriber::<u64>(name));
    let subscribers: Vec<_> = subscribers.map(Result::unwrap).collect();
    let publishers = names.iter().map(|name| talker.publisher::<u64>(name));
    let publishers: Vec<_> = publishers.map(Result::unwrap).collect();
    for (publisher, subscriber) in publishers.iter().zip(&subscribers) {
        meet(publisher, &[subscriber]);
    }
    for count in [1, 20] {
        let mut set = WaitSet::new().unwrap();
        for subscriber in &subscribers[..count] {
            set.add(subscriber, ()).unwrap();
        }
        let calls = least_calls(&mut set, (&publishers[0], &subscribers[0]));
        assert_eq!(calls, (2, 1), "{count} sources");
    }
}

//= SM2-TRN-013 test
#[test]
fn a_wait_survives_a_lack_of_memory() {
    Fixture::each(|it| {
        let subscriber = it.node("listener").subscriber::<u64>("topic").unwrap();
        let publisher = it.peer("talker").publisher::<u64>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, 0).unwrap();
        set.add_timer(Timer::once(SOON), 1);
        while set.try_wait().unwrap().is_some() {}
        publisher.publish(&1).unwrap();
        // The calls of the set, and those that read the sockets.
        let injector = Injector::new(Fault {
            call: Call::EpollWait,
            nth: 1,
            times: 5,
            errno: ENOMEM,
        });
        let installed = injector.install();
        assert_eq!(set.wait().unwrap().tag, 0);
        assert_eq!(injector.hits(), 5);
        drop(installed);
        assert_eq!(*subscriber.try_recv().unwrap().expect("a message"), 1);
    });
}

/// A set that has a readable socket, and no memory to read it, pauses between its tries.
//= SM2-TRN-013 test
#[test]
fn a_wait_does_not_spin_while_memory_is_short() {
    let domain = Domain::new();
    let node = |name| {
        let builder = domain.builder(name).ring_lane(false).background(false);
        builder.connect().unwrap()
    };
    let subscriber = node("listener").subscriber::<u64>("topic").unwrap();
    let publisher = node("talker").publisher::<u64>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    let mut set = WaitSet::new().unwrap();
    set.add(&subscriber, 0).unwrap();
    while set.try_wait().unwrap().is_some() {}
    publisher.publish(&1).unwrap();
    for call in [Call::RecvMsg, Call::EpollWait] {
        let injector = Injector::new(Fault {
            call,
            nth: 1,
            times: u64::MAX,
            errno: ENOMEM,
        });
        let installed = injector.install();
        let wait = Duration::from_millis(100);
        assert!(set.wait_timeout(wait).unwrap().is_none());
        drop(installed);
        // A pause lasts a millisecond or longer, and each try drives the node at most twice.
        let tries = injector.hits();
        assert!((1..=210).contains(&tries), "{call:?} {tries}");
    }
    assert_eq!(next(&mut set).tag, 0);
    assert_eq!(*subscriber.try_recv().unwrap().expect("a message"), 1);
}

/// A set that another error makes useless says so, instead of trying again for ever.
#[test]
fn a_wait_ends_with_an_error_that_is_no_lack_of_memory() {
    let mut set = WaitSet::new().unwrap();
    set.add_timer(Timer::once(SOON), ());
    let injector = Injector::new(Fault {
        call: Call::EpollWait,
        nth: 1,
        times: 1,
        errno: EBADF,
    });
    let _installed = injector.install();
    let error = set.wait().unwrap_err();
    assert!(error.to_string().contains("Bad file descriptor"), "{error}");
}
