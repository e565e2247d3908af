//! The system calls of a wait in a set: their number, and a lack of memory for them.

use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::wait::next;
use crate::common::{Domain, SOON, meet};
use nix::libc::ENOMEM;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::{Node, Timer, WaitSet};

/// One call finds a message among many sources, and one reads the sockets of its subscriber.
#[test]
fn a_wait_costs_the_same_for_any_number_of_sources() {
    let domain = Domain::new();
    let connect = |name| {
        let builder = Node::builder(name).socket(domain.socket());
        builder.background(true).connect().unwrap()
    };
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
        while set
            .wait_timeout(Duration::from_millis(20))
            .unwrap()
            .is_some()
        {}
        let injector = Injector::counting();
        publishers[0].publish(&1).unwrap();
        let installed = injector.install();
        next(&mut set);
        assert_eq!(
            injector.counts().get(&Call::EpollWait),
            Some(&2),
            "{count} sources"
        );
        injector.set(None);
        assert!(subscribers[0].try_recv().unwrap().is_some());
        // The end of the messages: no call but the one that finds nothing.
        injector.set(None);
        assert!(set.try_wait().unwrap().is_none());
        assert_eq!(
            injector.counts().get(&Call::EpollWait),
            Some(&1),
            "{count} sources"
        );
        drop(installed);
    }
}

//= SM2-TRN-014 test
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
