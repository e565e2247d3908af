//! The publishers of a run, and what they have published.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sm2_node::{Node, Publisher};
use sm2_proto::Name;

use super::super::Topics;
use super::random::Random;

/// The topics, and whether their publishers are reliable.
const TOPICS: [(&str, bool); 4] = [
    ("camera", false),
    ("map", false),
    ("scan", true),
    ("text", true),
];
/// The publishers of one moment.
const TALKERS_MAX: usize = 6;
/// The memory of a publisher that has little.
const SMALL_POOL: u64 = 600_000;

/// The messages of a publisher.
#[derive(Clone, Debug, Default)]
pub(super) struct Account {
    pub(super) topic: String,
    /// The lengths of the messages, by their numbers from 1 on.
    pub(super) lengths: Vec<usize>,
    /// The first number that the recorder is promised.
    pub(super) first: usize,
    /// At most so many of the last ones may be missing without a word: the publisher dropped them, and has ended.
    pub(super) unsaid: u64,
    /// Whether it was ever linked. A recording that ends has no time for a publisher that has just come.
    pub(super) was_linked: bool,
    /// Whether the recorder has its topic among those to record.
    pub(super) is_recorded: bool,
}

struct Talker {
    publisher: Publisher<[u8]>,
    node: String,
    latched: usize,
    has_lifespan: bool,
    is_sealed: bool,
}

/// The publishers of a run.
pub(super) struct Talkers {
    socket: PathBuf,
    talkers: Vec<Talker>,
    /// By the node.
    accounts: BTreeMap<String, Account>,
    /// Whether the recorder may have no room for all topics.
    are_few_recorded: bool,
}

/// The content of a message, which its publisher, its number and its length determine.
pub(super) fn payload(node: &str, number: usize, len: usize) -> Vec<u8> {
    let seed = node
        .bytes()
        .fold(number, |sum, it| sum * 31 + usize::from(it));
    (0..len).map(|at| (seed + at * 7) as u8).collect()
}

impl Talkers {
    pub(super) fn new(socket: &Path, are_few_recorded: bool) -> Self {
        Self {
            socket: socket.to_owned(),
            talkers: Vec::new(),
            accounts: BTreeMap::new(),
            are_few_recorded,
        }
    }

    /// The topics that there may be.
    pub(super) fn topics(&self) -> impl Iterator<Item = String> + use<> {
        let count = if self.are_few_recorded {
            2
        } else {
            TOPICS.len()
        };
        TOPICS.into_iter().take(count).map(|it| it.0.to_owned())
    }

    /// Those of them whose publishers are reliable.
    pub(super) fn reliable_topics(&self) -> impl Iterator<Item = String> + use<> {
        let all = TOPICS.into_iter().filter(|it| it.1);
        all.map(|it| it.0.to_owned())
    }

    pub(super) fn accounts(&self) -> &BTreeMap<String, Account> {
        &self.accounts
    }

    /// A publisher comes. Returns false if there are enough.
    pub(super) fn begin(&mut self, random: &mut Random, topics: &Topics) -> bool {
        if self.talkers.len() >= TALKERS_MAX {
            return false;
        }
        let node = format!("talker/{}", self.accounts.len());
        let (topic, is_reliable) = random.pick(&TOPICS);
        let latched = random.pick(&[0, 0, 1, 3]);
        let connected = Node::builder(&node).socket(&self.socket).connect();
        let connected = connected.unwrap();
        let mut builder = connected.publisher_builder::<[u8]>(topic);
        builder = builder.reliable(is_reliable).latched(latched);
        builder = builder.publish_timeout(Duration::ZERO);
        builder = builder.depth(random.pick(&[1, 8, 64]));
        // Sealed messages are on the socket lane.
        let is_sealed = random.one_in(4);
        builder = builder.sealed(is_sealed);
        if random.one_in(4) {
            builder = builder.pool_limit(SMALL_POOL);
        }
        let has_lifespan = random.one_in(6);
        if has_lifespan {
            builder = builder.lifespan(Duration::from_millis(2));
        }
        let account = Account {
            topic: topic.to_owned(),
            is_recorded: topics.choose(&Name::new(topic).unwrap()),
            ..Account::default()
        };
        self.accounts.insert(node.clone(), account);
        self.talkers.push(Talker {
            publisher: builder.declare().unwrap(),
            node,
            latched: latched.into(),
            has_lifespan,
            is_sealed,
        });
        // A latched publisher has messages before its first link; the newest ones come late.
        if random.one_in(2) {
            self.publish_by(self.talkers.len() - 1, 5, 20);
        }
        true
    }

    /// Whether the recorder has a link with the newest publisher, or does not want one.
    pub(super) fn newest_is_linked(&self) -> bool {
        let is_linked = |it: &Talker| {
            !self.accounts[&it.node].is_recorded || it.publisher.links().iter().any(|it| it.open)
        };
        self.talkers.last().is_none_or(is_linked)
    }

    /// A publisher publishes messages of about this length.
    pub(super) fn publish(&mut self, random: &mut Random, count: u64, len: u64) {
        if self.talkers.is_empty() {
            return;
        }
        let talker = random.below(self.talkers.len() as u64) as usize;
        for _ in 0..count {
            let len = len + random.below(10);
            self.publish_by(talker, 1, len as usize);
        }
    }

    fn publish_by(&mut self, talker: usize, count: usize, len: usize) {
        let Talker {
            publisher,
            node,
            latched,
            ..
        } = &self.talkers[talker];
        let account = self.accounts.get_mut(node).unwrap();
        let is_linked = publisher.links().iter().any(|it| it.open);
        for _ in 0..count {
            let number = account.lengths.len() + 1;
            // A publisher that itself holds all of its memory has published nothing.
            if publisher.publish(&payload(node, number, len)).is_err() {
                continue;
            }
            account.lengths.push(len);
            if !is_linked && !account.was_linked {
                account.first = (number + 1).saturating_sub(*latched);
            }
        }
        account.was_linked |= is_linked;
    }

    /// A publisher ends.
    pub(super) fn end_one(&mut self, random: &mut Random) {
        if self.talkers.is_empty() {
            return;
        }
        let at = random.below(self.talkers.len() as u64) as usize;
        let Talker {
            publisher,
            node,
            has_lifespan,
            is_sealed,
            ..
        } = self.talkers.remove(at);
        let counters = publisher.counters();
        let account = self.accounts.get_mut(&node).unwrap();
        account.unsaid = match has_lifespan {
            // The link has ended before its last messages were found too old.
            true => u64::from(u32::MAX),
            false => counters.pool_limit + counters.no_room,
        };
        if is_sealed {
            // On the socket lane, messages wait at the publisher, and displace each other there.
            account.unsaid += counters.in_flight + counters.overwritten;
        }
    }

    /// The recording has ended. A publisher does not know yet which of its messages the recorder found too old, so its
    /// counters do not tell how many it has not sent for that reason, until the next message shows it.
    pub(super) fn end(&mut self) {
        for it in self.talkers.iter().filter(|it| it.has_lifespan) {
            let account = self.accounts.get_mut(&it.node).unwrap();
            account.unsaid = it.publisher.counters().expired;
        }
        // On the socket lane, a message that waited at the publisher was not sent before the recorder ended.
        for it in self.talkers.iter().filter(|it| it.is_sealed) {
            let counters = it.publisher.counters();
            let account = self.accounts.get_mut(&it.node).unwrap();
            account.unsaid += counters.in_flight + counters.closed;
        }
    }
}
