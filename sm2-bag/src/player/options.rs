//! How a bag is played, and the result.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use sm2_proto::Name;

use crate::damaged::DamagedPart;
use crate::foreign::topic_name;
use crate::messages::Filter;

/// How a bag is played.
#[derive(Clone, Debug)]
pub struct PlayOptions {
    /// The topics and times.
    pub filter: Filter,
    /// The speed: 1 as recorded, 2 twice as fast; 0 as fast as possible. Not negative.
    pub rate: f64,
    /// Whether to begin with a pause: see [`PlayCommand`](crate::PlayCommand).
    pub paused: bool,
    /// The names of topics that are published under another name.
    pub remap: BTreeMap<Name, Name>,
    /// The segments before the names of topics, so that several replays do not mix; `None` for none. A topic of
    /// [`remap`](Self::remap) gets none.
    pub topic_prefix: Option<Name>,
    /// Whether nodes have their original names. Otherwise the name of the replay stands before them, and one node
    /// publishes for all of them if they are more than 64.
    pub original_names: bool,
    /// The name of the replay. The names of its nodes begin with it. `play` by default. Two replays at the same time
    /// need different ones.
    pub name: Name,
    /// How many subscribers of each topic to wait for before the first message.
    pub subscribers: usize,
    /// How long to wait for reliable subscribers that have no room; 10 s by default.
    pub room_timeout: Duration,
    /// Whether the player is the source of domain time. Recorded messages that would be published on the topic `clock`
    /// are left out then: a domain has one source.
    pub clock: bool,
    /// The number of members of a lockstep (SPEC 16.2) to wait for before the first message. The player is then its
    /// conductor and the source of domain time, all its publishers are reliable, and a bag is played once. `None`
    /// plays without lockstep.
    pub lockstep: Option<usize>,
}

impl Default for PlayOptions {
    fn default() -> Self {
        Self {
            filter: Filter::default(),
            rate: 1.0,
            paused: false,
            remap: BTreeMap::new(),
            topic_prefix: None,
            original_names: false,
            name: Name::new("play").expect("a legal name"),
            subscribers: 0,
            room_timeout: Duration::from_secs(10),
            clock: false,
            lockstep: None,
        }
    }
}

impl PlayOptions {
    /// The name of the node that publishes for a recorded one.
    pub(super) fn node_name(&self, recorded: &str) -> String {
        match self.original_names {
            true => recorded.to_owned(),
            false => format!("{}/{recorded}", self.name),
        }
    }

    /// Whether the player publishes domain time.
    pub(super) const fn is_clock_source(&self) -> bool {
        self.clock || self.lockstep.is_some()
    }

    /// The topic that gets the messages of a recorded topic.
    pub(super) fn published_topic<'a>(&'a self, recorded: &'a str) -> Cow<'a, str> {
        let recorded = topic_name(recorded);
        let remapped = self
            .remap
            .iter()
            .find(|(from, _)| from.as_str() == recorded);
        match (remapped, &self.topic_prefix) {
            (Some((_, to)), _) => to.as_str().into(),
            (None, Some(prefix)) => format!("{prefix}/{recorded}").into(),
            (None, None) => recorded.into(),
        }
    }
}

/// The result of playing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PlayReport {
    /// The topics, sorted by name.
    pub topics: Vec<PlayedTopic>,
    /// The members of the lockstep that left before the end.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left: Vec<String>,
    /// The topics that were left out, because the domain has another type for them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// The parts of the bags that are damaged. Their messages were left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damaged: Vec<DamagedPart>,
    /// Whether all messages were published. Otherwise the caller ended it.
    pub complete: bool,
}

/// A topic that was not played.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// The topic.
    pub topic: String,
    /// Why it was not played.
    pub reason: String,
}

/// The counts of one topic that was played.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PlayedTopic {
    /// The topic.
    pub name: String,
    /// The number of messages that were published.
    pub messages: u64,
    /// How many of them were published while no subscriber was linked.
    pub unheard: u64,
    /// How many messages subscribers missed, on all links together.
    pub missed: u64,
}
