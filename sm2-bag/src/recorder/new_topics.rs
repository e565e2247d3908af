//! When a recording of all topics subscribes to new ones.
//!
//! Other processes decide how many topics there are, and each topic needs descriptors. So new topics have their turn
//! when no message of the others waits. When descriptors are short, new topics are not recorded, and the recording goes
//! on.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt::Display;

use sm2_io::{free_descriptors, is_shortage};
use sm2_node::DeclareError;
use sm2_node::domain::{Contract, Domain};
use sm2_proto::Name;

use super::options::Topics;
use super::topic::Topic;
use crate::error::RecordError;
use crate::missing::MissingTopic;
use crate::patterns::{Pattern, TopicPatterns};

/// The descriptors that new topics leave to the files of the recording, and to further links of the topics that are
/// recorded. A process with few descriptors leaves half of them. `sm2-node` leaves 64 of them when it accepts links.
const RESERVE: usize = 128;
/// The descriptors that a link may need, as `sm2-node` counts them.
const PER_LINK: usize = 2;
/// The descriptors of a subscriber in a wait set, and of its first link.
const PER_TOPIC: usize = 2 + PER_LINK;
/// The names of so many topics are logged; then only their number is.
const LOGGED_MAX: usize = 16;
/// More topics than this that are not recorded are not counted: their names take memory.
const MISSED_MAX: usize = 65_536;
/// The bag names so many topics that are not recorded: each name takes room in the file.
const NAMED_MAX: usize = 4_096;
/// A topic that the Manager has refused may be tried again after this time, when the domain has changed.
const RETRY_NS: u64 = 1_000_000_000;

/// The topics that a recording of all topics has not subscribed to yet.
pub(super) struct NewTopics {
    /// The topics of the domain.
    known: BTreeMap<Name, State>,
    /// The topics that are recorded; `None` for those only that the recorder has subscribed to at its start.
    patterns: Option<TopicPatterns>,
    /// The patterns that no topic has matched so far.
    unmatched: Vec<Pattern>,
    /// The topics that wait for their turn, the oldest one first.
    waiting: VecDeque<Name>,
    /// Whether the domain has changed since it was looked at.
    is_stale: bool,
    /// Whether there is no room now.
    is_paused: bool,
    missed: Missed,
    /// When refused topics may be tried again.
    retry_at_ns: u64,
    /// The descriptors that new topics leave.
    reserve: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Waiting,
    Recorded,
    /// The Manager does not let this node subscribe to it.
    Refused,
}

impl NewTopics {
    pub(super) fn new(topics: &Topics) -> Self {
        let free = free_descriptors(2 * RESERVE).unwrap_or(2 * RESERVE);
        let patterns = match topics {
            Topics::All => Some(TopicPatterns::default()),
            Topics::Named(_) => None,
            Topics::Matching(_, patterns) => Some(patterns.clone()),
        };
        Self {
            unmatched: patterns
                .iter()
                .flat_map(|it| &it.include)
                .cloned()
                .collect(),
            patterns,
            known: topics.named().map(|it| (it, State::Recorded)).collect(),
            waiting: VecDeque::new(),
            is_stale: false,
            is_paused: false,
            missed: Missed::default(),
            retry_at_ns: 0,
            reserve: free / 2,
        }
    }

    /// Whether a topic may have its turn.
    pub(super) fn has_next(&self) -> bool {
        !self.is_paused && (self.is_stale || self.has_waiting())
    }

    fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// The patterns that no topic has matched so far.
    pub(super) fn unmatched(&self) -> &[Pattern] {
        &self.unmatched
    }

    /// Lets topics without room try again.
    pub(super) const fn resume(&mut self) {
        self.is_paused = false;
    }

    /// The number of topics that are not recorded now.
    pub(super) fn missed(&self) -> usize {
        self.missed.now.len()
    }

    /// The number of topics that have not been recorded for a time.
    pub(super) const fn count(&self) -> usize {
        self.missed.count
    }

    /// The beginnings and ends of times without a topic, since the last call.
    pub(super) fn take_changes(&mut self) -> Vec<MissingTopic> {
        std::mem::take(&mut self.missed.changes)
    }

    /// The number of topics that were not recorded, and that the bag does not name.
    pub(super) const fn unnamed(&self) -> usize {
        self.missed.count - self.missed.named
    }

    /// Has the topics of the domain compared again, because the domain has changed.
    pub(super) const fn domain_changed(&mut self) {
        self.is_stale = self.patterns.is_some();
    }

    /// The topic that has its turn, if there is room beside `topics`, which are recorded.
    pub(super) fn next(
        &mut self,
        domain: &Domain,
        topics: &mut [Topic],
        now_ns: u64,
    ) -> Option<Name> {
        let has_room = self.has_room(topics);
        // While topics are subscribed to, the domain is not looked at for each of them.
        if self.is_stale && !(has_room && self.has_waiting()) {
            self.update(domain, now_ns);
        }
        if !has_room {
            self.pause(
                &"too few descriptors are left: raise the limit (ulimit -n)",
                now_ns,
            );
            return None;
        }
        self.waiting.pop_front()
    }

    /// Takes over the topics of the domain.
    fn update(&mut self, domain: &Domain, now_ns: u64) {
        let publishers = domain
            .interfaces()
            .filter(|it| matches!(it.contract, Contract::Publisher { .. }));
        let topics = publishers.map(|it| it.contract.name());
        let patterns = self.patterns.as_ref();
        let topics: BTreeSet<_> = topics
            .filter(|it| patterns.is_some_and(|patterns| patterns.choose(it.as_str())))
            .collect();
        self.is_stale = false;
        let is_unmatched = |it: &Pattern| !topics.iter().any(|topic| it.matches(topic.as_str()));
        self.unmatched.retain(is_unmatched);
        self.waiting.retain(|it| topics.contains(it));
        (self.known).retain(|it, state| *state == State::Recorded || topics.contains(it));
        self.missed.retain(|it| topics.contains(it), now_ns);
        if now_ns >= self.retry_at_ns {
            self.retry_at_ns = now_ns.saturating_add(RETRY_NS);
            for (topic, state) in &mut self.known {
                if *state == State::Refused {
                    *state = State::Waiting;
                    self.waiting.push_back(topic.clone());
                }
            }
        }
        for topic in topics {
            if !self.known.contains_key(topic) {
                self.known.insert(topic.clone(), State::Waiting);
                self.waiting.push_back(topic.clone());
            }
        }
    }

    /// Whether a further topic leaves the reserve, also when those of `topics` that wait for their first link get it.
    fn has_room(&self, topics: &mut [Topic]) -> bool {
        let least = self.reserve + PER_TOPIC;
        let most = least + PER_LINK * topics.len();
        // If the number is unknown, subscribing tells.
        let Ok(free) = free_descriptors(most) else {
            return true;
        };
        // Nearly always.
        if free >= most {
            return true;
        }
        topics.iter_mut().for_each(Topic::look_for_link);
        let unlinked = topics.iter().filter(|it| !it.was_linked).count();
        free >= least + PER_LINK * unlinked
    }

    /// The topics that wait have no room now.
    fn pause(&mut self, reason: &dyn Display, now_ns: u64) {
        self.is_paused = true;
        for topic in &self.waiting {
            self.missed.add(topic, reason, now_ns);
        }
    }

    /// Sets whether the recorder has subscribed to a topic. Returns the errors that end the recording.
    pub(super) fn set_subscribed(
        &mut self,
        topic: Name,
        subscribed: Result<(), RecordError>,
        now_ns: u64,
    ) -> Result<(), RecordError> {
        match subscribed {
            Ok(()) => {
                self.missed.end(&topic, now_ns);
                self.known.insert(topic, State::Recorded);
            }
            Err(error) if may_pass(&error) => {
                self.waiting.push_front(topic);
                self.pause(&error, now_ns);
            }
            // The access policy may deny this topic. The others are recorded.
            Err(RecordError::Declare(error)) => {
                self.missed.add(&topic, &error, now_ns);
                self.known.insert(topic, State::Refused);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }
}

/// The topics that are not recorded.
#[derive(Default)]
struct Missed {
    /// The topics that are not recorded now; `None` for a topic that has no name in the bag.
    now: BTreeMap<Name, Option<MissingTopic>>,
    /// How many have not been recorded for a time.
    count: usize,
    /// How many of them the bag names.
    named: usize,
    changes: Vec<MissingTopic>,
}

impl Missed {
    /// Adds a topic that is not recorded from now on, and logs it.
    fn add(&mut self, topic: &Name, reason: &dyn Display, now_ns: u64) {
        if self.now.len() >= MISSED_MAX || self.now.contains_key(topic) {
            return;
        }
        self.count += 1;
        let count = self.count;
        let named = (self.named < NAMED_MAX).then(|| MissingTopic {
            topic: topic.to_string(),
            reason: reason.to_string(),
            from_ns: now_ns,
            to_ns: None,
        });
        self.named += usize::from(named.is_some());
        self.changes.extend(named.clone());
        self.now.insert(topic.clone(), named);
        if count <= LOGGED_MAX {
            tracing::error!(%topic, error = %reason, "the topic is not recorded");
        } else if count.is_power_of_two() {
            tracing::error!("{count} topics are not recorded so far");
        }
    }

    /// Keeps these topics. The time of the others is over.
    fn retain(&mut self, is_kept: impl Fn(&Name) -> bool, now_ns: u64) {
        let ended = self.now.keys().filter(|it| !is_kept(it));
        let ended: Vec<_> = ended.cloned().collect();
        ended.iter().for_each(|it| self.end(it, now_ns));
    }

    /// The time of a topic is over, if it was missing.
    fn end(&mut self, topic: &Name, now_ns: u64) {
        let ended = self.now.remove(topic).flatten();
        self.changes.extend(ended.map(|it| MissingTopic {
            to_ns: Some(now_ns),
            ..it
        }));
    }
}

/// Whether subscribing to the same topic may succeed later.
fn may_pass(error: &RecordError) -> bool {
    match error {
        RecordError::System(error) | RecordError::Declare(DeclareError::Io(error)) => {
            is_shortage(error)
        }
        RecordError::Declare(error) => matches!(
            error,
            DeclareError::Quota { .. }
                | DeclareError::TimedOut { .. }
                | DeclareError::ManagerGone { .. }
        ),
        _ => false,
    }
}

#[cfg(test)]
mod tests;
