//! Losses and missed deadlines between two readings of counters.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, domain::LinkView, text::Counted};

use crate::{observation::Readings, sampling::hundredths, view::View};

/// A link that dropped messages between two readings.
#[derive(Serialize)]
pub(super) struct Losing {
    sender: String,
    receiver: String,
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
        let lost = readings.growth(|it| it.ends(view, link).sent, |it| it.fates.dropped())?;
        let offered = readings.growth(|it| it.ends(view, link).sent, |it| it.fates.offered)?;
        (lost > 0).then(|| Self {
            sender: sender.to_owned(),
            receiver: receiver.to_owned(),
            lost_per_s: per_s(lost),
            offered_per_s: per_s(offered),
            seconds: hundredths(window_s),
        })
    }
}

/// `listener:scan did not get 28 of 30 messages/s of talker:scan in the last 1 s`
impl fmt::Display for Losing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            sender,
            receiver,
            lost_per_s,
            offered_per_s,
            seconds,
        } = self;
        write!(
            f,
            "{receiver} did not get {lost_per_s} of {offered_per_s} messages/s of {sender} in the last {seconds} s"
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
