//! The messages that a publisher publishes while it has no link with a subscriber: the account of the subscriber,
//! beside the sets of messages that the simulated publisher knows.

// Shows LNK-AWAY (proptest), bound: cases; sampled links of one pair that end with any rest, latched or not.

use std::collections::{BTreeSet, VecDeque};

use crate::link_support::*;
use crate::support::cases;
use proptest::prelude::*;
use sm2_proto::{
    Machine, Name,
    limits::ABSENCES_MAX,
    link::{
        Absences, Account, Config, Input, Link, Missed, Publications, Record, Role, wire::Frame,
    },
};

/// The number of the publisher.
const PUBLISHER: u64 = 77;

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

const fn published(published: u64) -> Publications {
    Publications {
        publisher: PUBLISHER,
        published,
    }
}

/// The record of a publisher whose last message that was taken had this id.
fn taken_up_to(id: u64) -> Record {
    let (mut account, away) = Account::open(published(0), false, None);
    assert_eq!(away, 0);
    account.take(id, 0);
    account.close(Some(id), 0, 0)
}

const fn missed(lost: u64, away: u64, unreported: u64) -> Missed {
    Missed {
        lost,
        away,
        unreported,
    }
}

//= SM2-OPN-006 test
#[test]
fn open_says_what_a_publisher_has_published() {
    let says = |role, publications| {
        let config = Config {
            publications,
            ..config(role)
        };
        let mut link = Link::new(config);
        let bytes = sent(&drain(&mut link))[0].to_vec();
        match Frame::decode(&sm2_proto::Datagram::new(&bytes)) {
            Ok(Frame::Open(open)) => open.publications,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(says(Role::Sender, published(5)), published(5));
    let nameless = Publications {
        publisher: 0,
        published: 5,
    };
    assert_eq!(says(Role::Sender, nameless), Publications::UNKNOWN);
    for role in [Role::Receiver, Role::Caller, Role::Server] {
        assert_eq!(says(role, published(5)), Publications::UNKNOWN);
    }

    let mut link = Link::new(config(Role::Receiver));
    drain(&mut link);
    assert_eq!(link.peer_publications(), Publications::UNKNOWN);
    let Frame::Open(mut open) = open_to(&config(Role::Receiver)) else {
        unreachable!()
    };
    open.publications = published(5);
    accept(&mut link, &Frame::Open(open));
    assert_eq!(link.peer_publications(), published(5));
    // A subscriber whose link is over still has to know.
    assert_eq!(link.handle(NOW, Input::Eof), Ok(()));
    assert_eq!(link.peer_publications(), published(5));
}

//= SM2-QOS-013 test
#[test]
fn one_message_that_was_published_meanwhile_counts_when_the_link_opens() {
    let (mut account, away) = Account::open(published(11), false, Some(taken_up_to(10)));
    assert_eq!(away, 1);
    // The next message reports it, and does not count it again.
    assert_eq!(account.take(12, 0), missed(0, 0, 1));
    assert!(account.is_settled());
    // Message 13 was published while the link opened.
    let (mut account, away) = Account::open(published(12), false, Some(taken_up_to(10)));
    assert_eq!((away, account.take(14, 0)), (2, missed(0, 1, 2)));
}

#[test]
fn a_first_link_misses_nothing() {
    // Of a publisher that has published for long, and goes on while the link opens.
    let (mut account, away) = Account::open(published(100), false, None);
    assert_eq!((away, account.take(110, 0)), (0, missed(0, 0, 0)));
    // Messages that were displaced on the link count as before.
    let (mut account, _) = Account::open(published(100), false, None);
    assert_eq!(account.take(110, 3), missed(3, 0, 0));
    // It ends without a message: from its OPEN on, messages are missed.
    let (account, _) = Account::open(published(100), false, None);
    let (_, away) = Account::open(published(104), false, Some(account.close(None, 0, 0)));
    assert_eq!(away, 4);
}

#[test]
fn what_the_link_lost_is_not_counted_as_away_too() {
    // Of 11 to 19, five were displaced on the link.
    let (mut account, away) = Account::open(published(10), false, Some(taken_up_to(10)));
    assert_eq!((away, account.take(20, 5)), (0, missed(5, 4, 0)));
    // The link cannot have lost more than there were.
    let (mut account, _) = Account::open(published(10), false, Some(taken_up_to(10)));
    assert_eq!(account.take(12, 5), missed(1, 0, 0));
}

#[test]
fn what_a_latched_publisher_sends_again_is_repeated_and_not_lost() {
    let record = Some(taken_up_to(10));
    // The last five of twelve: 11 was published meanwhile, but it comes.
    let (mut account, away) = Account::open(published(12), true, record);
    assert_eq!((away, account.take(8, 0)), (0, missed(0, 0, 0)));
    assert!(!account.is_settled());
    // A gap among messages that were taken before.
    assert_eq!(account.take(10, 1), missed(0, 0, 0));
    assert_eq!(account.take(11, 0), missed(0, 0, 0));
    assert!(account.is_settled());
    // The last two of twenty: 11 to 18 do not come.
    let (mut account, away) = Account::open(published(20), true, record);
    assert_eq!((away, account.take(19, 0)), (0, missed(0, 8, 0)));
}

#[test]
fn messages_with_another_fate_are_not_away() {
    // Of a link that was denied, three messages were dropped and counted as lost.
    let (mut account, _) = Account::open(published(0), false, None);
    account.take(10, 0);
    let record = account.close(Some(10), 3, 2);
    let (mut account, away) = Account::open(published(20), false, Some(record));
    // The next message reports the dropped ones, and what was lost before messages that have expired.
    assert_eq!((away, account.take(21, 0)), (7, missed(0, 0, 3 + 2 + 7)));
    // Messages expire before the first one that is taken.
    let (mut account, _) = Account::open(published(20), true, Some(taken_up_to(10)));
    assert_eq!(account.expire(9, 0), missed(0, 0, 0));
    assert_eq!(account.expire(14, 0), missed(0, 3, 0));
    assert_eq!(account.expire(16, 1), missed(1, 0, 0));
    assert_eq!(account.take(18, 1), missed(1, 0, 0));
    // The link ends in between, and the last of them comes again.
    let (mut account, _) = Account::open(published(20), true, Some(taken_up_to(10)));
    account.expire(14, 0);
    let record = Some(account.close(Some(14), 0, 3));
    let (mut account, _) = Account::open(published(20), true, record);
    assert_eq!(account.expire(14, 0), missed(0, 0, 0));
    assert_eq!(account.take(15, 0), missed(0, 0, 3));
}

#[test]
fn what_no_message_has_reported_is_reported_on_a_later_link() {
    let (account, away) = Account::open(published(13), false, Some(taken_up_to(10)));
    let (mut account, more) = Account::open(published(15), false, Some(account.close(None, 0, 0)));
    assert_eq!((away, more, account.take(16, 0)), (3, 2, missed(0, 0, 5)));
    assert_eq!(account.take(18, 1), missed(1, 0, 0));
}

#[test]
fn no_number_of_another_process_makes_it_fail() {
    for until in [1, u64::MAX] {
        for claimed in [0, 1, u64::MAX] {
            for latched in [false, true] {
                let record = Some(taken_up_to(until));
                let (mut account, away) = Account::open(published(claimed), latched, record);
                assert!(away <= claimed);
                account.expire(u64::MAX, u64::MAX);
                account.take(u64::MAX, u64::MAX);
                let record = account.close(Some(u64::MAX), u64::MAX, u64::MAX);
                let (mut account, _) = Account::open(published(claimed), latched, Some(record));
                account.take(1, u64::MAX);
            }
        }
    }
}

//= SM2-QOS-013 test
#[test]
fn a_bounded_number_of_publishers_is_remembered() {
    let mut absences = Absences::default();
    let nodes: Vec<_> = (0..=ABSENCES_MAX).map(|n| name(&format!("n{n}"))).collect();
    for node in &nodes {
        absences.keep(node.clone(), PUBLISHER, taken_up_to(1));
    }
    assert_eq!(
        absences.take(&nodes[0], PUBLISHER),
        None,
        "the oldest is forgotten"
    );
    for node in &nodes[1..] {
        assert_eq!(absences.take(node, PUBLISHER), Some(taken_up_to(1)));
        assert_eq!(absences.take(node, PUBLISHER), None, "it has a link now");
    }
}

#[test]
fn a_publisher_is_known_by_its_number_and_its_node() {
    let mut absences = Absences::default();
    absences.keep(name("a"), 1, taken_up_to(1));
    absences.keep(name("a"), 1, taken_up_to(2));
    assert_eq!(absences.take(&name("a"), 2), None);
    assert_eq!(absences.take(&name("b"), 1), None);
    assert_eq!(absences.take(&name("a"), 1), Some(taken_up_to(2)));
    assert_eq!(absences.take(&name("a"), 1), None);
}

/// One step of a publisher, its links and its subscriber.
#[derive(Clone, Copy, Debug)]
enum Step {
    Publish(u8),
    /// The publisher's end of a new link sends OPEN.
    Link,
    /// The subscriber's OPEN reaches the publisher, which sends the latched messages.
    Open,
    /// The link ends. The last messages in it do not reach the subscriber.
    End {
        unread: u8,
    },
    /// The subscriber takes messages; the first `expired` of them have expired.
    Take {
        most: u8,
        expired: u8,
    },
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1_u8..6).prop_map(Step::Publish),
        2 => Just(Step::Link),
        3 => Just(Step::Open),
        2 => (0_u8..4).prop_map(|unread| Step::End { unread }),
        4 => (1_u8..6, prop_oneof![4 => Just(0_u8), 1 => 1_u8..3])
            .prop_map(|(most, expired)| Step::Take { most, expired }),
    ]
}

/// A link as the subscriber sees it.
#[derive(Debug)]
struct Way {
    /// `published` of its OPEN.
    published: u64,
    open: bool,
    over: bool,
    /// The ids of the messages that can be taken.
    ready: VecDeque<u64>,
    account: Option<Account>,
    /// The id before the first message that came.
    base: Option<u64>,
    last: Option<u64>,
    /// Losses before messages that have expired.
    pending: Missed,
}

/// A publisher and a subscriber that keeps the last `depth` messages.
#[derive(Debug, Default)]
struct Play {
    latched: u64,
    depth: usize,
    published: u64,
    ways: VecDeque<Way>,
    absences: Absences,
    /// The ids that were handed to the program, and those that have expired.
    taken: BTreeSet<u64>,
    expired: BTreeSet<u64>,
    /// All messages up to this one are older than their lifespan.
    expired_until: u64,
    /// The counts of the subscriber.
    lost: u64,
    away: u64,
    /// The losses that it reports with messages.
    reported: u64,
    /// The first id whose fate counts, once it is known.
    first: Option<u64>,
}

impl Play {
    fn step(&mut self, step: Step) {
        match step {
            Step::Publish(count) => (0..count).for_each(|_| self.publish()),
            Step::Link if self.ways.back().is_none_or(|it| it.over) => self.link(),
            Step::Open => self.open(),
            Step::End { unread } => self.end(usize::from(unread)),
            Step::Take { most, expired } => {
                for n in 0..most {
                    self.take(n < expired);
                }
            }
            Step::Link => {}
        }
        self.run_until_quiet();
    }

    fn publish(&mut self) {
        self.published += 1;
        let id = self.published;
        let open = self.ways.back_mut().filter(|it| it.open && !it.over);
        if let Some(way) = open {
            way.bring(id, self.depth);
        }
    }

    fn link(&mut self) {
        self.ways.push_back(Way {
            published: self.published,
            open: false,
            over: false,
            ready: VecDeque::new(),
            account: None,
            base: None,
            last: None,
            pending: Missed::default(),
        });
    }

    fn open(&mut self) {
        let (published, latched, depth) = (self.published, self.latched, self.depth);
        if let Some(way) = self.ways.back_mut().filter(|it| !it.open && !it.over) {
            way.open = true;
            let first = published.saturating_sub(latched).max(self.expired_until) + 1;
            for id in first..=published {
                way.bring(id, depth);
            }
        }
    }

    fn end(&mut self, unread: usize) {
        if let Some(way) = self.ways.back_mut().filter(|it| !it.over) {
            way.over = true;
            way.ready.truncate(way.ready.len().saturating_sub(unread));
        }
    }

    /// The subscriber opens the account of the oldest link, and removes links that are over and empty.
    fn run_until_quiet(&mut self) {
        let node = name("publisher");
        while let Some(way) = self.ways.front_mut() {
            if way.account.is_none() {
                let record = self.absences.take(&node, PUBLISHER);
                let is_latched = self.latched > 0;
                let (account, away) = Account::open(published(way.published), is_latched, record);
                way.account = Some(account);
                self.away += away;
            }
            if !way.over || !way.ready.is_empty() {
                return;
            }
            let Missed { lost, away, .. } = way.pending;
            self.lost += lost;
            self.away += away;
            let record = way.account.unwrap().close(way.last, 0, lost + away);
            if way.last.is_none() && self.first.is_none() {
                self.first = Some(way.published + 1);
            }
            self.absences.keep(node.clone(), PUBLISHER, record);
            self.ways.pop_front();
        }
    }

    fn take(&mut self, is_expired: bool) {
        self.run_until_quiet();
        let Some(way) = self.ways.front_mut() else {
            return;
        };
        let Some(id) = way.ready.pop_front() else {
            return;
        };
        let lost = id - way.last.or(way.base).unwrap() - 1;
        self.first.get_or_insert(id - lost);
        way.last = Some(id);
        let account = way.account.as_mut().unwrap();
        if is_expired || id <= self.expired_until {
            self.expired_until = self.expired_until.max(id);
            let missed = account.expire(id, lost);
            way.pending.lost += missed.lost;
            way.pending.away += missed.away;
            self.expired.insert(id);
            return;
        }
        let mut missed = match account.is_settled() {
            true => missed(lost, 0, 0),
            false => account.take(id, lost),
        };
        let pending = std::mem::take(&mut way.pending);
        missed.lost += pending.lost;
        missed.away += pending.away;
        self.lost += missed.lost;
        self.away += missed.away;
        self.reported += missed.lost + missed.away + missed.unreported;
        self.taken.insert(id);
    }

    /// All links end, and one more brings a last message: everything published has a fate then.
    fn finish(&mut self) {
        self.step(Step::End { unread: 0 });
        self.step(Step::Take {
            most: u8::MAX,
            expired: 0,
        });
        self.step(Step::Link);
        self.step(Step::Open);
        self.step(Step::Publish(1));
        self.step(Step::Take {
            most: u8::MAX,
            expired: 0,
        });
    }
}

impl Way {
    fn bring(&mut self, id: u64, depth: usize) {
        self.base.get_or_insert(id - 1);
        self.ready.push_back(id);
        if self.ready.len() > depth {
            self.ready.pop_front();
        }
    }
}

proptest! {
    #![proptest_config(cases(2_000))]

    /// `published = taken + expired + lost on links + away`, over the life of the pair.
    //= SM2-QOS-013 test
    #[test]
    fn every_message_has_one_fate(
        steps in prop::collection::vec(step(), 1..80),
        latched in prop_oneof![Just(0_u64), 1_u64..5],
        depth in 1_usize..6,
    ) {
        let mut play = Play { latched, depth, ..Play::default() };
        for step in steps {
            play.step(step);
        }
        play.finish();
        prop_assert_eq!(play.taken.last(), Some(&play.published), "{:?}", play);
        let first = play.first.unwrap();
        let since = |ids: &BTreeSet<u64>| ids.range(first..).copied().collect::<BTreeSet<_>>();
        let known = &since(&play.taken) | &since(&play.expired);
        let sum = known.len() as u64 + play.lost + play.away;
        prop_assert_eq!(sum, play.published - (first - 1), "{:?}", play);
        prop_assert_eq!(play.reported, play.lost + play.away, "{:?}", play);
    }
}
