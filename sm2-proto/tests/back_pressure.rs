//! How long a publisher waits for its reliable links, in virtual time: the links are machines, and the publisher does
//! what a node does.

// Shows DAT-WAIT (proptest), bound: sampled patterns of up to 10 receivers, each for 8 s of virtual time.

use std::time::Duration;

use crate::link_support::*;
use crate::support::cases;
use proptest::collection::vec;
use proptest::prelude::*;
use sm2_proto::{
    Instant, Machine, WaitBudget,
    link::{Fate, Input, Link, NoMemory, Role, wire::Given},
};

const MS: u64 = 1_000_000;
/// The default of a publisher.
const TIMEOUT: Duration = Duration::from_millis(100);
const PERIOD: u64 = 5 * MS;
const MESSAGES: u64 = 1_600;

/// A reliable subscriber that releases its oldest messages in a pattern, with room for five messages.
struct Peer {
    link: Link,
    sent: u64,
    released: u64,
    /// The pauses, and how many messages are released after each of them. It begins anew at its end.
    pattern: Vec<(u64, u64)>,
    at: usize,
    next: u64,
}

impl Peer {
    fn new(pattern: Vec<(u64, u64)>) -> Self {
        Self {
            link: opened(reliable(Role::Sender)),
            sent: 0,
            released: 0,
            next: pattern[0].0,
            pattern,
            at: 0,
        }
    }

    fn has_room(&self) -> bool {
        self.link.has_room(&NoMemory)
    }

    fn send(&mut self, id: u64) {
        let outputs = send(&mut self.link, message(id));
        self.sent += sent(&outputs).len() as u64;
    }

    /// Does what the subscriber has done until now.
    fn run(&mut self, now: u64) {
        while self.next <= now {
            let count = self.pattern[self.at].1;
            for _ in 0..count.min(self.sent - self.released) {
                self.released += 1;
                let outputs = release_all(&mut self.link, Given::Consumed, &[self.released]);
                self.sent += sent(&outputs).len() as u64;
            }
            self.at = (self.at + 1) % self.pattern.len();
            self.next += self.pattern[self.at].0;
        }
    }
}

struct Publisher {
    now: u64,
    budget: WaitBudget,
    peers: Vec<Peer>,
    published: u64,
    /// Begin and end of each wait.
    waits: Vec<(u64, u64)>,
}

impl Publisher {
    fn new(share_percent: u8, peers: impl IntoIterator<Item = Vec<(u64, u64)>>) -> Self {
        Self {
            now: 0,
            budget: WaitBudget::new(share_percent),
            peers: peers.into_iter().map(Peer::new).collect(),
            published: 0,
            waits: Vec::new(),
        }
    }

    /// Publishes for 8 s, at 200 Hz as long as it need not wait. A subscriber that keeps up gets each of these
    /// messages.
    fn run(&mut self) {
        let mut due = 0;
        while due < MESSAGES * PERIOD {
            self.now = due;
            self.publish();
            due = (due + PERIOD).max(self.now);
        }
    }

    fn publish(&mut self) {
        self.published += 1;
        let id = self.published;
        let mut waiting = Vec::new();
        for (at, peer) in self.peers.iter_mut().enumerate() {
            peer.run(self.now);
            if peer.has_room() {
                peer.send(id);
            } else if peer.link.owes() {
                peer.link.handle(NOW, Input::Drop(Fate::NoRoom)).unwrap();
            } else {
                waiting.push(at);
            }
        }
        if waiting.is_empty() {
            return;
        }
        let begin = self.now;
        let grant = self.budget.grant(Instant(self.now), TIMEOUT);
        while !waiting.is_empty() && self.now < grant.until().0 {
            let next = self.peers.iter().map(|peer| peer.next).min();
            self.now = next.unwrap_or(u64::MAX).min(grant.until().0);
            for peer in &mut self.peers {
                peer.run(self.now);
            }
            waiting.retain(|at| {
                let peer = &mut self.peers[*at];
                let room = peer.has_room();
                if room {
                    peer.send(id);
                }
                !room
            });
        }
        self.budget.charge(grant, Instant(self.now));
        self.waits.push((begin, self.now));
        for at in waiting {
            let peer = &mut self.peers[at];
            peer.link.handle(NOW, Input::Drop(Fate::NoRoom)).unwrap();
            assert!(peer.link.owes());
        }
    }

    /// Checks that in each period the waits take at most one timeout and the share of the period.
    fn check(&self, share_percent: u64) {
        let most = 100 * TIMEOUT.as_nanos() as u64;
        let (mut excess, mut last) = (0_u64, 0);
        for &(begin, end) in &self.waits {
            excess = excess.saturating_sub((begin - last) * share_percent);
            excess += (end - begin) * (100 - share_percent);
            assert!(excess <= most, "{excess} at {end}");
            last = end;
        }
        let waited: u64 = self.waits.iter().map(|(begin, end)| end - begin).sum();
        assert_eq!(self.budget.waited(), Duration::from_nanos(waited));
    }

    fn missed(&self, at: usize) -> u64 {
        self.peers[at].link.counters().no_room
    }
}

/// One message each 20 ms, which made each publication wait.
const NOW_AND_THEN: [(u64, u64); 1] = [(20 * MS, 1)];

//= SM2-QOS-003, SM2-QOS-004 test
#[test]
fn links_that_release_now_and_then_are_waited_for_once() {
    for count in [1, 10] {
        let mut publisher = Publisher::new(1, vec![NOW_AND_THEN.to_vec(); count]);
        publisher.run();
        publisher.check(1);
        assert!(
            publisher.published * 100 >= MESSAGES * 97,
            "{}",
            publisher.published
        );
        for at in 0..count {
            let counters = publisher.peers[at].link.counters();
            assert_eq!(counters.offered, publisher.published);
            assert!(counters.no_room > 1_000, "{counters:?}");
        }
    }
}

/// Its window is full after 25 ms, and the publisher waits for the rest of its pause.
//= SM2-QOS-002 test
#[test]
fn a_link_that_is_briefly_behind_misses_nothing() {
    let pause = [(80 * MS, 5), (MS, 5)];
    let mut pattern = pause.to_vec();
    pattern.extend(vec![(MS, 5); 10_000]);
    let mut publisher = Publisher::new(1, [pattern]);
    publisher.run();
    publisher.check(1);
    assert_eq!((publisher.missed(0), publisher.waits.len()), (0, 1));
}

/// With the share of 100 %, the publisher is as slow as the link.
//= SM2-QOS-004 test
#[test]
fn without_a_limit_a_slow_link_misses_nothing() {
    let mut publisher = Publisher::new(100, [NOW_AND_THEN.to_vec()]);
    publisher.run();
    publisher.check(100);
    assert_eq!(publisher.missed(0), 0);
    assert!(publisher.published < MESSAGES / 3);
}

//= SM2-QOS-004 test
#[test]
fn what_is_left_ends_a_wait() {
    let at = |ms: u64| Instant(ms * MS);
    let ms = Duration::from_millis;
    let mut budget = WaitBudget::new(1);
    let grant = budget.grant(at(1_000), ms(100));
    assert_eq!(grant.until(), at(1_100));
    budget.charge(grant, at(1_060));
    assert_eq!(budget.waited(), ms(60));
    // 40 ms are left, and 0.6 ms were gained in the wait. A timeout of 110 ms adds 10 ms.
    let grant = budget.grant(at(1_060), ms(110));
    assert_eq!(grant.until(), Instant(at(1_110).0 + 600_000));
    budget.charge(grant, at(1_200));
    // The time after the end of a grant was not waited.
    assert_eq!(budget.waited(), ms(110) + Duration::from_micros(600));
    let grant = budget.grant(at(1_200), ms(110));
    assert_eq!(grant.until(), Instant(at(1_201).0 + 400_000));
    let none = budget.grant(at(1_200), ms(110));
    assert!(none.is_empty() && !grant.is_empty());
    // Full again, and no more than full.
    let grant = budget.grant(at(100_000), ms(1_00));
    assert_eq!(grant.until(), at(100_100));
    let grant = budget.grant(at(100_000), ms(1_00));
    assert_eq!(grant.until(), at(100_010));
    // No timeout is too long.
    let grant = budget.grant(at(100_000), Duration::MAX);
    assert!(grant.until() > at(1_000_000_000));
}

proptest! {
    #![proptest_config(cases(300))]

    /// The publisher waits for its share only, and subscribers that keep up get at least 0.97 of the messages that they
    /// would get alone. Any number of other subscribers releases any number of messages at any time.
    //= SM2-QOS-004 test
    #[test]
    fn any_pattern_of_releases_leaves_the_others_their_share(
        patterns in vec(vec((1..300_u64, 0..=6_u64), 1..6), 1..=10)
    ) {
        let in_ns = |(pause_ms, count): (u64, u64)| (pause_ms * MS, count);
        let patterns = patterns.into_iter().map(|it| it.into_iter().map(in_ns).collect());
        let mut publisher = Publisher::new(WaitBudget::SHARE_DEFAULT_PERCENT, patterns);
        publisher.run();
        publisher.check(u64::from(WaitBudget::SHARE_DEFAULT_PERCENT));
        prop_assert!(publisher.published * 100 >= MESSAGES * 97, "{}", publisher.published);
        for peer in &publisher.peers {
            let it = peer.link.counters();
            prop_assert_eq!(it.offered, publisher.published);
            prop_assert_eq!(it.offered, it.delivered + it.no_room + it.in_flight);
        }
    }

    /// The same for any share.
    //= SM2-QOS-004 test
    #[test]
    fn the_waits_keep_to_any_share(
        share in 0..=100_u8,
        patterns in vec(vec((1..300_u64, 0..=6_u64), 1..6), 1..=4)
    ) {
        let in_ns = |(pause_ms, count): (u64, u64)| (pause_ms * MS, count);
        let patterns = patterns.into_iter().map(|it| it.into_iter().map(in_ns).collect());
        let mut publisher = Publisher::new(share, patterns);
        publisher.run();
        publisher.check(u64::from(share));
    }
}
