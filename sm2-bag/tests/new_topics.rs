//! Topics that begin while a recording of all topics runs.

use std::cell::RefCell;
use std::os::fd::AsFd;
use std::time::Duration;

use sm2_bag::{Options, Recorder, Topics};
use sm2_node::{Publisher, Shutdown};
use sm2_proto::Instant;

use crate::common::{Domain, SOON, until};

/// A topic that has a message whenever the recorder looks, until another topic has its link.
struct Busy {
    topic: Publisher<u64>,
    other: Publisher<u64>,
    until: Instant,
}

thread_local! {
    static BUSY: RefCell<Option<Busy>> = const { RefCell::new(None) };
}

/// The clock that the recorder looks at for each message. It stands still, so that no topic is frequent.
fn clock() -> Instant {
    BUSY.with_borrow_mut(|busy| {
        busy.take_if(|it| is_linked(&it.other) || sm2_io::clock::now() > it.until);
        if let Some(busy) = busy {
            busy.topic.publish(&1).unwrap();
        }
    });
    Instant(1)
}

fn is_linked(publisher: &Publisher<u64>) -> bool {
    publisher.links().iter().any(|it| it.open)
}

/// A topic that always has messages does not keep the recorder from subscribing to a new one.
#[test]
fn a_new_topic_has_its_turn_beside_a_busy_one() {
    let domain = Domain::new();
    let (node, shutdown) = (domain.node("recorder"), Shutdown::new().unwrap());
    let options = Options {
        monotonic_clock: clock,
        ..Options::new(Topics::All)
    };
    let storage = domain.create("bag");
    let mut recorder = Recorder::start(&node, storage, options, shutdown.as_fd()).unwrap();
    let talker = domain.node("talker");
    let topic = talker.publisher::<u64>("busy").unwrap();
    let mut step = || recorder.step(Duration::from_millis(1)).unwrap();
    until("the first topic is linked", || {
        step();
        is_linked(&topic)
    });
    let other = domain.node("other").publisher::<u64>("other").unwrap();
    topic.publish(&1).unwrap();
    let until = sm2_io::clock::now().after(SOON);
    let busy = Busy {
        topic,
        other,
        until,
    };
    BUSY.set(Some(busy));
    // The call that finds the new topic takes messages of the busy one as long as there are any.
    while BUSY.with_borrow(Option::is_some) {
        step();
        assert!(sm2_io::clock::now() < until, "the topic has no turn");
    }
    recorder.finish().unwrap();
}
