//! Synchronizers: in executors, in wait sets and alone, with and without the background thread, on both lanes.

use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::{SOON, number_in_slot, until};
use sm2_node::synchronizer::{Input, InputCounters};
use sm2_node::{
    Executor, Instant, Node, PublishError, Published, Publisher, RecvError, Sample, Shutdown,
    SubscriberBuilder, Synchronizer, Timer, WaitSet,
};

type Pair = (Sample<[u64]>, Sample<[u64]>);

/// A topic whose messages need slots, so that a subscriber holds them.
struct Topic(Publisher<[u64]>);

impl Topic {
    fn publish(&self, time: &u64) -> Result<Published, PublishError> {
        self.0.publish(&number_in_slot(*time))
    }
}

/// Two topics whose messages are their own times, in nanoseconds.
struct Topics {
    left: Topic,
    right: Topic,
    _node: Node,
}

impl Topics {
    fn new(it: &Fixture) -> Self {
        let node = it.peer("source");
        let topic = |name| {
            let builder = node.publisher_builder::<[u64]>(name).reliable(true);
            Topic(builder.publish_timeout(SOON).declare().unwrap())
        };
        Self {
            left: topic("left"),
            right: topic("right"),
            _node: node,
        }
    }

    /// Waits until both topics are linked with the synchronizer.
    fn wait(&self) {
        for topic in [&self.left, &self.right] {
            topic.0.wait_for_subscribers_timeout(1, SOON).unwrap();
        }
    }
}

/// Waits until both topics are linked, and drives the node of the synchronizer meanwhile.
fn link(topics: &Topics, synchronizer: &mut Synchronizer<Pair>) {
    until(|| {
        assert!(synchronizer.try_recv().unwrap().is_none());
        [&topics.left, &topics.right]
            .iter()
            .all(|it| it.0.links().iter().any(|link| link.open))
    });
}

fn input(node: &Node, topic: &str) -> Input<[u64]> {
    Input::new(subscriber(node, topic)).time(|message| Instant(message[0]))
}

fn subscriber(node: &Node, topic: &str) -> SubscriberBuilder<[u64]> {
    node.subscriber_builder(topic).reliable(true).depth(64)
}

fn inputs(node: &Node) -> (Input<[u64]>, Input<[u64]>) {
    (input(node, "left"), input(node, "right"))
}

fn values((left, right): Pair) -> (u64, u64) {
    (left[0], right[0])
}

/// The message of 100 of the left topic completes two sets, and then no message wakes the wait set for the second one.
fn publish_two_sets_at_once(topics: &Topics) {
    topics.left.publish(&10).unwrap();
    for time in [12, 100] {
        topics.right.publish(&time).unwrap();
    }
    topics.left.publish(&100).unwrap();
}

#[test]
fn an_executor_runs_a_callback_for_each_set() {
    Fixture::each(|it| {
        for threads in [1, 3] {
            let it = it.again();
            let topics = Topics::new(&it);
            let node = it.node("fusion");
            let synchronizer = Synchronizer::approximate(inputs(&node)).declare().unwrap();
            let mut executor = Executor::new().unwrap();
            executor.end_with(&it.shutdown).unwrap();
            let group = executor.group(Vec::new());
            group.on_set(synchronizer, |sets: &mut Vec<_>, set| {
                sets.push(values(set?));
                if sets.len() == 2 {
                    it.shutdown.request();
                }
                Ok(())
            });
            group.on_tick(Timer::once(5 * SOON), |_, _| Err("it hangs".into()));
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    topics.wait();
                    publish_two_sets_at_once(&topics);
                });
                executor.run_threads(threads).unwrap();
            });
            assert_eq!(group.with(|sets| sets.clone()), [(10, 12), (100, 100)]);
        }
    });
}

/// The program takes one set for each report.
#[test]
fn a_wait_set_reports_a_synchronizer_until_it_has_no_set() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let mut synchronizer = Synchronizer::approximate(inputs(&node)).declare().unwrap();
        let mut set = WaitSet::new().unwrap();
        let keys = set.add_synchronizer(&mut synchronizer, 'S').unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                topics.wait();
                publish_two_sets_at_once(&topics);
            });
            let mut sets = Vec::new();
            while sets.len() < 2 {
                let ready = set.wait_timeout(SOON).unwrap().expect("a set is left");
                assert!(ready.tag == 'S' && keys.contains(&ready.key));
                sets.extend(synchronizer.try_recv().unwrap().map(values));
            }
            assert_eq!(sets, [(10, 12), (100, 100)]);
            assert!(synchronizer.try_recv().unwrap().is_none());
        });
        assert_eq!(synchronizer.sets(), 2);
        for key in keys {
            assert!(set.remove(key));
        }
        assert!(set.is_empty());
    });
}

#[test]
fn recv_waits_for_a_set_and_counts_what_has_none() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let mut synchronizer = Synchronizer::exact(inputs(&node))
            .queue(4)
            .declare()
            .unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                topics.wait();
                for time in [1, 2, 4, 3, 5] {
                    topics.left.publish(&time).unwrap();
                }
                for time in [2, 5] {
                    topics.right.publish(&time).unwrap();
                }
            });
            let set = synchronizer.recv_timeout(SOON).unwrap();
            assert_eq!(set.map(values), Some((2, 2)));
            let set = synchronizer.recv_timeout(SOON).unwrap();
            assert_eq!(set.map(values), Some((5, 5)));
        });
        assert!(synchronizer.recv_timeout(Duration::ZERO).unwrap().is_none());
        let InputCounters {
            received,
            used,
            unmatched,
            out_of_order,
            overflow,
            ..
        } = synchronizer.counters(0).unwrap();
        assert_eq!((received, used, unmatched), (5, 2, 2));
        assert_eq!((out_of_order, overflow), (1, 0));
        assert_eq!(synchronizer.counters(1).unwrap().used, 2);
        assert!(synchronizer.counters(2).is_none() && synchronizer.topic(2).is_none());
        assert_eq!(synchronizer.topic(1).unwrap().as_str(), "right");
    });
}

/// Messages are held, not copied: as many as the queue, and those of the sets that the program says it holds.
#[test]
fn a_synchronizer_never_exceeds_its_borrow_limit() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let builder = Synchronizer::exact(inputs(&node)).queue(2).sets_held(3);
        let mut synchronizer = builder.declare().unwrap();
        link(&topics, &mut synchronizer);
        let mut sets: Vec<Pair> = Vec::new();
        for time in 1..=3 {
            topics.left.publish(&time).unwrap();
            topics.right.publish(&time).unwrap();
            sets.push(synchronizer.recv_timeout(SOON).unwrap().expect("a set"));
        }
        // The queue of the left topic is full, and the program holds three sets.
        for time in 4..40 {
            topics.left.publish(&time).unwrap();
            while synchronizer.counters(0).unwrap().received < time {
                let none = synchronizer.recv_timeout(Duration::from_millis(1)).unwrap();
                assert!(none.is_none());
            }
        }
        let counters = synchronizer.counters(0).unwrap();
        assert_eq!((counters.held, counters.overflow), (2, 34));
        topics.right.publish(&39).unwrap();
        sets.push(synchronizer.recv_timeout(SOON).unwrap().expect("a set"));
        // More sets than it knows of are too many.
        for time in 40..=45 {
            topics.left.publish(&time).unwrap();
            topics.right.publish(&time).unwrap();
        }
        let error = loop {
            match synchronizer.recv_timeout(SOON) {
                Ok(set) => sets.push(set.expect("a set or an error")),
                Err(error) => break error,
            }
        };
        assert!(
            matches!(error, RecvError::TooManyBorrowed { .. }),
            "{error:?}"
        );
        let values: Vec<_> = sets.drain(..).map(values).collect();
        assert!(
            values.iter().all(|(left, right)| left == right),
            "{values:?}"
        );
        // It goes on where it was.
        let set = synchronizer.recv_timeout(SOON).unwrap().expect("a set");
        assert_eq!(set.0[0], values.last().unwrap().0 + 1);
    });
}

/// Without a function, the time of a message is that of its publication.
#[test]
fn publication_times_are_the_default() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let inputs = (subscriber(&node, "left"), subscriber(&node, "right"));
        let mut synchronizer = Synchronizer::approximate(inputs).declare().unwrap();
        link(&topics, &mut synchronizer);
        for number in 0..3 {
            topics.left.publish(&number).unwrap();
            topics.right.publish(&number).unwrap();
        }
        let (left, right) = synchronizer.recv_timeout(SOON).unwrap().expect("a set");
        assert!(left[0].abs_diff(right[0]) <= 1, "{left:?}, {right:?}");
    });
}

#[test]
fn a_shutdown_ends_recv() {
    Fixture::each(|it| {
        let node = it.ending_node("fusion");
        let mut synchronizer = Synchronizer::exact(inputs(&node)).declare().unwrap();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| synchronizer.recv_timeout(SOON).map(|_| ()));
            it.shutdown.request();
            let ended = waiting.join().unwrap();
            assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        });
        let ended = synchronizer.recv_timeout(SOON).map(|_| ());
        assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        assert!(Shutdown::is_requested(&it.shutdown));
    });
}

/// After a jump of the clock, old messages must not hold back new ones.
#[test]
fn clear_begins_anew() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let mut synchronizer = Synchronizer::exact(inputs(&node)).declare().unwrap();
        link(&topics, &mut synchronizer);
        topics.left.publish(&1_000).unwrap();
        while synchronizer.counters(0).unwrap().held == 0 {
            assert!(
                synchronizer
                    .recv_timeout(Duration::from_millis(1))
                    .unwrap()
                    .is_none()
            );
        }
        synchronizer.clear();
        assert_eq!(synchronizer.counters(0).unwrap().unmatched, 1);
        topics.left.publish(&1).unwrap();
        topics.right.publish(&1).unwrap();
        let set = synchronizer.recv_timeout(SOON).unwrap().expect("a set");
        assert_eq!(values(set), (1, 1));
    });
}

/// Samples outlive their synchronizer, like those of a subscriber.
#[test]
fn a_set_outlives_its_synchronizer() {
    Fixture::each(|it| {
        let topics = Topics::new(it);
        let node = it.node("fusion");
        let mut synchronizer = Synchronizer::exact(inputs(&node)).declare().unwrap();
        link(&topics, &mut synchronizer);
        topics.left.publish(&1).unwrap();
        topics.right.publish(&1).unwrap();
        let set = synchronizer.recv_timeout(SOON).unwrap().expect("a set");
        drop((synchronizer, node));
        assert_eq!(values(set), (1, 1));
    });
}
