//! Subscribers that keep their samples do not take a publisher's memory from the others.

// Shows DAT-LOCAL (test), bound: one process.

use std::time::Duration;

use crate::common::{Domain, meet, next, pattern, until};
use sm2_io::fault::{Call, Injector};
use sm2_node::{
    POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES, Published, Publisher, PublisherBuilder, Sample,
    Subscriber,
};
use sm2_proto::link::Counters;

const LEN: usize = 100_000;
const LIMIT: u64 = 8 << 20;

#[derive(Clone, Copy, Debug)]
enum Form {
    Ring,
    Pooled,
    Sealed,
}

const FORMS: [Form; 3] = [Form::Ring, Form::Pooled, Form::Sealed];

impl Form {
    const fn is_ring(self) -> bool {
        matches!(self, Self::Ring)
    }

    /// How many messages fit into half of the limit: slots of 128 KiB, or files as long as the message.
    const fn held(self) -> u64 {
        match self {
            Self::Ring | Self::Pooled => 32,
            Self::Sealed => 41,
        }
    }
}

fn builder(domain: &Domain, form: Form) -> PublisherBuilder<[u8]> {
    let node = domain.node_on(form.is_ring(), "talker");
    let builder = node.publisher_builder::<[u8]>("topic");
    builder.sealed(matches!(form, Form::Sealed)).depth(1)
}

fn subscriber(domain: &Domain, form: Form, name: &str) -> Subscriber<[u8]> {
    let node = domain.node_on(form.is_ring(), name);
    let builder = node.subscriber_builder::<[u8]>("topic");
    builder.depth(4).max_borrowed(1_000).declare().unwrap()
}

fn counters(publisher: &Publisher<[u8]>, name: &str) -> Counters {
    let links = publisher.links();
    let link = links.iter().find(|link| link.peer.name.as_str() == name);
    link.expect("a link").counters
}

/// Subscribers that keep every sample.
struct Hoard {
    subscriber: Subscriber<[u8]>,
    samples: Vec<(u64, Sample<[u8]>)>,
}

impl Hoard {
    fn new(domain: &Domain, form: Form, name: &str) -> Self {
        Self {
            subscriber: subscriber(domain, form, name),
            samples: Vec::new(),
        }
    }

    fn take(&mut self, seed: u64) {
        if let Some(sample) = self.subscriber.recv_timeout(Duration::ZERO).unwrap() {
            self.samples.push((seed, sample));
        }
    }

    fn check(&self) {
        for (seed, sample) in &self.samples {
            assert!(**sample == *pattern(LEN, *seed), "{seed}");
        }
    }
}

/// The publisher, two subscribers that keep their samples, and one that does not.
struct Scene {
    publisher: Publisher<[u8]>,
    hoards: [Hoard; 2],
    reader: Subscriber<[u8]>,
    published: u64,
}

impl Scene {
    fn new(domain: &Domain, form: Form) -> Self {
        let publisher = builder(domain, form).pool_limit(LIMIT).declare().unwrap();
        let [first, second] = ["first", "second"].map(|name| Hoard::new(domain, form, name));
        let reader = subscriber(domain, form, "reader");
        meet(
            &publisher,
            &[&first.subscriber, &second.subscriber, &reader],
        );
        Self {
            publisher,
            hoards: [first, second],
            reader,
            published: 0,
        }
    }

    /// Publishes messages. All subscribers take them; the reader releases each at once.
    fn publish(&mut self, messages: u64) {
        for _ in 0..messages {
            let bytes = pattern(LEN, self.published);
            self.publisher.publish(&bytes).unwrap();
            let sample = next(&self.reader);
            assert!(
                *sample == *bytes && sample.lost() == 0,
                "{}",
                self.published
            );
            self.hoards
                .iter_mut()
                .for_each(|it| it.take(self.published));
            self.published += 1;
            assert!(self.publisher.pool_bytes() <= LIMIT);
        }
    }

    fn check(&self, hoard: usize, held: u64, delivered: u64) {
        let it = counters(&self.publisher, ["first", "second"][hoard]);
        let expected = Counters {
            offered: self.published,
            delivered,
            in_flight: held,
            pool_limit: self.published - held - delivered,
            ..Counters::default()
        };
        assert_eq!(it, expected);
        assert_eq!(self.hoards[hoard].samples.len() as u64, held);
        self.hoards[hoard].check();
    }
}

//= SM2-QOS-007 test
#[test]
fn two_that_never_release_leave_half_of_the_limit_to_the_third() {
    /// More than the limit has room for.
    const MANY: u64 = if cfg!(feature = "slow") { 300 } else { 60 };
    for form in FORMS {
        println!("{form:?}");
        let domain = Domain::new();
        let mut scene = Scene::new(&domain, form);
        scene.publish(MANY);
        scene.check(0, form.held(), 0);
        scene.check(1, form.held(), 0);
        let reader = counters(&scene.publisher, "reader");
        assert_eq!((reader.offered, reader.dropped()), (MANY, 0));

        // One that releases samples gets messages again, about as many as it releases.
        let kept = scene.hoards[0].samples.split_off(10);
        let released = scene.hoards[0].samples.len() as u64;
        scene.hoards[0].samples = kept;
        scene.publish(20);
        let it = counters(&scene.publisher, "first");
        assert_eq!((it.delivered, it.dropped()), (released, it.pool_limit));
        assert!(it.in_flight > form.held() - released, "{it:?}");
        assert!(it.in_flight <= 3 * form.held() / 2, "{it:?}");
        scene.check(0, it.in_flight, released);
        scene.check(1, form.held(), 0);

        // When all samples are back, both get everything.
        for hoard in &mut scene.hoards {
            hoard.samples.clear();
        }
        scene.publish(20);
        for name in ["first", "second"] {
            let it = counters(&scene.publisher, name);
            assert!(it.in_flight >= 20, "{form:?} {it:?}");
        }
        let reader = counters(&scene.publisher, "reader");
        assert_eq!((reader.offered, reader.dropped()), (MANY + 40, 0));
    }
}

/// Messages that a subscriber discards untaken are released as well, so it gets messages again.
//= SM2-QOS-007, SM2-QOS-001 test
#[test]
fn a_subscriber_that_discards_messages_is_no_longer_suspended() {
    for form in [Form::Pooled, Form::Sealed] {
        let domain = Domain::new();
        let publisher = builder(&domain, form).pool_limit(LIMIT).declare().unwrap();
        let subscriber = subscriber(&domain, form, "reader");
        meet(&publisher, &[&subscriber]);
        // They wait in the socket until a call of the subscriber reads it.
        for seed in 0..2 * form.held() {
            publisher.publish(&pattern(LEN, seed)).unwrap();
        }
        let before = counters(&publisher, "reader");
        assert!(before.pool_limit > 0, "{form:?} {before:?}");
        // Both calls drive their nodes. The subscriber keeps as many as its depth.
        until(|| {
            subscriber.links();
            counters(&publisher, "reader").in_flight <= 4
        });
        assert_eq!(publisher.publish(&pattern(LEN, 1)).unwrap().links, 1);
        let it = counters(&publisher, "reader");
        assert_eq!((it.delivered, it.pool_limit), (0, before.pool_limit));
    }
}

/// A publisher waits for a reliable subscriber that holds too much once, and then not again until it
/// releases a sample.
//= SM2-QOS-007, SM2-QOS-002 test
#[test]
fn a_reliable_subscriber_that_never_releases_is_waited_for_once() {
    const TIMEOUT: Duration =
        Duration::from_millis(if cfg!(feature = "slow") { 1_000 } else { 50 });
    for form in FORMS {
        let domain = Domain::new();
        let builder = builder(&domain, form)
            .reliable(true)
            .publish_timeout(TIMEOUT);
        let publisher = builder.pool_limit(LIMIT).declare().unwrap();
        let node = domain.node_on(form.is_ring(), "first");
        let builder = node.subscriber_builder::<[u8]>("topic").max_borrowed(1_000);
        let mut hoard = Hoard {
            subscriber: builder.reliable(true).declare().unwrap(),
            samples: Vec::new(),
        };
        meet(&publisher, &[&hoard.subscriber]);
        let calls = Injector::counting();
        let sleeps = || calls.counts().contains_key(&Call::Poll);
        let (mut missed, mut waits) = (0, 0);
        for seed in 0..60 {
            let bytes = pattern(LEN, seed);
            calls.set(None);
            let installed = calls.install();
            missed += publisher.publish(&bytes).unwrap().missed as u64;
            drop(installed);
            waits += usize::from(sleeps());
            hoard.take(seed);
        }
        let it = counters(&publisher, "first");
        assert_eq!(
            (it.in_flight, it.pool_limit),
            (form.held(), 60 - form.held())
        );
        assert_eq!((it.offered, missed), (60, it.pool_limit));
        assert_eq!(waits, 1, "one wait, not one for each message: {form:?}");
        hoard.check();
        hoard.samples.clear();
        assert_eq!(publisher.publish(&pattern(LEN, 60)).unwrap().missed, 0);
    }
}

/// Messages that no longer fit at all are not errors of the publisher, however it makes them.
//= SM2-QOS-007 test
#[test]
fn subscribers_that_hold_all_memory_cause_no_error() {
    for form in FORMS {
        let domain = Domain::new();
        let publisher = builder(&domain, form)
            .pool_limit(1 << 20)
            .declare()
            .unwrap();
        let mut hoard = Hoard::new(&domain, form, "first");
        meet(&publisher, &[&hoard.subscriber]);
        for seed in 0..10 {
            publisher.publish(&pattern(LEN, seed)).unwrap();
            hoard.take(seed);
        }
        let held = counters(&publisher, "first").in_flight;
        assert!((4..=5).contains(&held), "{form:?} {held}");
        // These need more than is left.
        let long = pattern(800_000, 1);
        assert_eq!(publisher.publish(&long).unwrap().links, 0);
        let mut loan = publisher.loan_slice(long.len()).unwrap();
        loan.copy_from_slice(&long);
        assert_eq!(loan.publish().unwrap().links, 0);
        let it = counters(&publisher, "first");
        assert_eq!((it.offered, it.pool_limit), (12, 12 - held), "{form:?}");
        hoard.check();
        hoard.samples.clear();
        assert_eq!(publisher.publish(&long).unwrap().links, 1, "{form:?}");
        assert!(*next(&hoard.subscriber) == *long);
        // A message that never fits is an error.
        let error = publisher.publish(&vec![0; 2 << 20]);
        assert!(error.is_err() || counters(&publisher, "first").in_flight > 0);
    }
}

/// A link that holds little is not suspended for the sake of others, and misses a message for which they leave no
/// memory. The publisher hears which of its reliable subscribers do not get the message.
//= SM2-QOS-007, SM2-QOS-008 test
#[test]
fn a_message_without_memory_is_lost_on_every_link() {
    for form in FORMS {
        let domain = Domain::new();
        let builder = builder(&domain, form).reliable(true);
        let publisher = builder.pool_limit(1 << 20).declare().unwrap();
        let mut hoard = Hoard::new(&domain, form, "first");
        let reliable = |name| {
            let node = domain.node_on(form.is_ring(), name);
            node.subscriber_builder::<[u8]>("topic").reliable(true)
        };
        let reader = reliable("reader").declare().unwrap();
        let short = reliable("short").max_len(LEN as u64).declare().unwrap();
        meet(&publisher, &[&hoard.subscriber, &reader, &short]);
        for seed in 0..10 {
            publisher.publish(&pattern(LEN, seed)).unwrap();
            hoard.take(seed);
            drop((next(&reader), next(&short)));
        }
        let published = publisher.publish(&pattern(800_000, 1)).unwrap();
        let lost = Published {
            links: 0,
            missed: 2,
            too_long: 1,
        };
        assert_eq!(published, lost, "{form:?}");
        let it = counters(&publisher, "reader");
        assert_eq!((it.offered, it.pool_limit), (11, 1), "{form:?}");
        let it = counters(&publisher, "short");
        assert_eq!((it.pool_limit, it.too_long), (0, 1), "{form:?}");
        // The message had a number, which no other message gets.
        publisher.publish(&pattern(LEN, 11)).unwrap();
        let sample = next(&reader);
        assert_eq!((sample.sequence(), sample.lost()), (12, 1), "{form:?}");
        hoard.check();
    }
}

/// The default: half of 256 MiB for messages that are not released, and more only for long messages.
#[test]
fn the_default_limit_holds() {
    const LEN: usize = 4 << 20;
    assert_eq!((POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES), (256 << 20, 24));
    let domain = Domain::new();
    let publisher = builder(&domain, Form::Ring).declare().unwrap();
    let first = subscriber(&domain, Form::Ring, "first");
    meet(&publisher, &[&first]);
    let mut samples = Vec::new();
    let mut loan = |byte| {
        let mut loan = publisher.loan_slice(LEN).unwrap();
        loan[0] = byte;
        loan.publish().unwrap();
        samples.extend(first.try_recv().unwrap());
    };
    (0..30).for_each(&mut loan);
    // Slots of 6 MiB.
    let it = counters(&publisher, "first");
    assert_eq!((it.in_flight, it.pool_limit), (21, 9));
    assert!(publisher.pool_bytes() <= POOL_LIMIT_BYTES);
    assert!(samples.iter().zip(0..).all(|(it, byte)| it[0] == byte));
}
