//! Losses and missed deadlines between two readings of counters.

use std::fmt;

use serde::{Serialize, Serializer};
use sm2_proto::{
    EntityId,
    domain::LinkView,
    link::{Counters, Fate},
    text::Counted,
};

use crate::{observation::Readings, sampling::hundredths, view::View};

/// A link that dropped messages between two readings.
#[derive(Serialize)]
pub(crate) struct Losing {
    sender: String,
    receiver: String,
    /// The fate of most of these messages.
    #[serde(serialize_with = "as_word")]
    fate: Fate,
    /// The messages of each second that were dropped.
    lost_per_s: f64,
    /// The messages of each second that were offered to the link.
    offered_per_s: f64,
    /// The time between the readings.
    seconds: f64,
}

impl Losing {
    pub(super) fn find(
        view: &View<'_>,
        readings: Readings<'_>,
        link: &LinkView,
        sender: &str,
        receiver: &str,
    ) -> Option<Self> {
        let window_s = readings.window()?.as_secs_f64();
        let per_s = |messages: u64| hundredths(messages as f64 / window_s);
        let growth = |count: &dyn Fn(&Counters) -> u64| {
            readings.growth(|it| it.ends(view, link).sent, |it| count(&it.fates))
        };
        let lost = growth(&Counters::dropped)?;
        let offered = growth(&|it| it.offered)?;
        let drops = Fate::ALL.into_iter().filter(|it| it.is_drop());
        let fate = drops.max_by_key(|fate| growth(&|it| it.of(*fate)))?;
        (lost > 0).then(|| Self {
            sender: sender.to_owned(),
            receiver: receiver.to_owned(),
            fate,
            lost_per_s: per_s(lost),
            offered_per_s: per_s(offered),
            seconds: hundredths(window_s),
        })
    }

    /// Whether these are messages from `sender` to `receiver`.
    pub(crate) fn is_between(&self, sender: &str, receiver: &str) -> bool {
        self.sender == sender && self.receiver == receiver
    }

    /// The reason, as a clause.
    const fn reason(&self) -> &'static str {
        match self.fate {
            Fate::Delivered | Fate::Overwritten | Fate::Discarded => {
                "its program does not take them in time"
            }
            Fate::NoRoom => "it made no room in time",
            Fate::Closed => "its links ended",
            Fate::PoolLimit => "it holds too much memory of the publisher",
            Fate::TooLong => "they are longer than it accepts",
            Fate::Expired => "they were older than the lifespan",
        }
    }

    /// The remedy, as an imperative clause.
    pub(crate) const fn remedy(&self) -> &'static str {
        match self.fate {
            Fate::Delivered | Fate::Overwritten | Fate::Discarded | Fate::Expired => {
                "let the program do less for each message, or raise the depth if messages come in bursts"
            }
            Fate::NoRoom => {
                "let the program do less for each message, or raise publish_timeout and wait_share_percent"
            }
            Fate::Closed => "see why links end in the logs of the two programs",
            Fate::PoolLimit => "let the program drop samples, or raise pool_limit",
            Fate::TooLong => "raise max_len of the subscriber, or split the messages",
        }
    }
}

fn as_word<S: Serializer>(fate: &Fate, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(fate.as_str())
}

/// `listener:scan did not get 28 of 30 messages/s of talker:scan in the last 1 s, because its program does not take
/// them in time`
impl fmt::Display for Losing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            sender,
            receiver,
            lost_per_s,
            offered_per_s,
            seconds,
            ..
        } = self;
        let reason = self.reason();
        write!(
            f,
            "{receiver} did not get {lost_per_s} of {offered_per_s} messages/s of {sender} in the last {seconds} s, \
             because {reason}"
        )
    }
}

/// An interface that missed deadlines between two readings.
#[derive(Serialize)]
pub(crate) struct MissingDeadlines {
    /// The publisher or subscriber.
    pub(crate) interface: String,
    /// The number of periods without a message.
    periods: u64,
    /// The time between the readings.
    seconds: f64,
}

impl MissingDeadlines {
    pub(super) fn find(view: &View<'_>, readings: Readings<'_>, of: &[EntityId]) -> Vec<Self> {
        let Some(window) = readings.window() else {
            return Vec::new();
        };
        let missing = |&entity: &EntityId| {
            let periods = readings.growth(
                |it| it.interface(view.domain, entity),
                |it| it.missed_deadlines,
            )?;
            (periods > 0).then(|| Self {
                interface: view.title(entity),
                periods,
                seconds: hundredths(window.as_secs_f64()),
            })
        };
        of.iter().filter_map(missing).collect()
    }
}

/// `listener:scan missed its deadline in 10 periods in the last 1 s`
impl fmt::Display for MissingDeadlines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            interface,
            periods,
            seconds,
        } = self;
        let periods = Counted::new(*periods, "period");
        write!(
            f,
            "{interface} missed its deadline in {periods} in the last {seconds} s"
        )
    }
}
