//! Troubles on links, as the counters of their two ends tell.

mod losing;
mod taking;

use std::{collections::BTreeSet, fmt};

use serde::Serialize;
use sm2_io::clock;
use sm2_proto::{EntityId, LinkId, counters::Entry, domain::LinkView, text::Counted};

use self::taking::Holding;
pub(crate) use self::{
    losing::{Losing, MissingDeadlines},
    taking::{NotTaking, untaken},
};
use crate::{observation::Readings, sampling::hundredths, view::View};

/// The troubles on the links of some interfaces.
#[derive(Default, Serialize)]
pub(crate) struct LinkTroubles {
    /// The time between the two readings of counters that rates come from; `None` without rates.
    observed_s: Option<f64>,
    /// The ends of links that take nothing although messages wait.
    pub(crate) not_taking: Vec<NotTaking>,
    /// The interfaces that miss deadlines now.
    pub(crate) missing_deadlines: Vec<MissingDeadlines>,
    /// The ends of links whose nodes are short of memory.
    short_of_memory: Vec<ShortOfMemory>,
    /// The links that dropped messages for their length.
    too_long: Vec<TooLong>,
    /// The links that drop messages now.
    losing: Vec<Losing>,
    /// The ends of links that hold all the samples that they can hold, while no message waits.
    holding: Vec<Holding>,
}

/// A link whose sender has dropped messages that are longer than the other side accepts (SM2-QOS-008).
#[derive(Serialize)]
struct TooLong {
    /// The interface that sends.
    sender: String,
    /// The interface that does not accept messages of this length.
    receiver: String,
    /// The number of messages.
    messages: u64,
}

/// An end of a link whose node is short of memory there (SM2-TRN-013).
#[derive(Serialize)]
struct ShortOfMemory {
    /// The interface whose node is short of memory.
    interface: String,
    /// The interface at the other end.
    peer: String,
    /// How long the shortage has lasted.
    seconds: f64,
}

impl LinkTroubles {
    /// The troubles on the links of these interfaces. `readings` are of the counters of the nodes at both ends.
    pub(crate) fn find(view: &View<'_>, readings: Readings<'_>, of: &[EntityId]) -> Self {
        let window = readings.window();
        let mut troubles = Self {
            observed_s: window.map(|it| hundredths(it.as_secs_f64())),
            missing_deadlines: MissingDeadlines::find(view, readings, of),
            ..Self::default()
        };
        let mut seen: BTreeSet<LinkId> = BTreeSet::new();
        let links = of.iter().flat_map(|it| view.links_of(*it));
        for link in links.filter(|link| seen.insert(link.link)) {
            troubles.add(view, readings, link);
        }
        troubles
    }

    /// The troubles on all links.
    pub(crate) fn of_all(view: &View<'_>, readings: Readings<'_>) -> Self {
        let all: Vec<_> = view.granted().map(|it| it.entity).collect();
        Self::find(view, readings, &all)
    }

    fn add(&mut self, view: &View<'_>, readings: Readings<'_>, link: &LinkView) {
        let ends = readings.now.ends(view, link);
        let [sender, receiver] = [ends.sender, ends.receiver].map(|it| view.title(it));
        let messages = ends.sent.map_or(0, |entry| entry.fates.too_long);
        if messages > 0 {
            self.too_long.push(TooLong {
                sender: sender.clone(),
                receiver: receiver.clone(),
                messages,
            });
        }
        let both = [
            (ends.sent, &sender, &receiver),
            (ends.taken, &receiver, &sender),
        ];
        for (entry, interface, peer) in both {
            if let Some(seconds) = entry.and_then(short_seconds) {
                self.short_of_memory.push(ShortOfMemory {
                    interface: interface.clone(),
                    peer: peer.clone(),
                    seconds,
                });
            }
        }
        self.losing
            .extend(Losing::find(view, readings, link, &sender, &receiver));
        let not_taking = NotTaking::find(&ends, readings.now.at(), &sender, &receiver);
        if not_taking.is_none() {
            let holding = Holding::find(&ends, readings.now.at(), &sender, &receiver);
            self.holding.extend(holding);
        }
        self.not_taking.extend(not_taking);
    }

    /// The links that drop messages now, but for those whose other end takes nothing at all.
    pub(crate) fn losing(&self) -> impl Iterator<Item = &Losing> {
        self.losing.iter().filter(|it| self.takes(it))
    }

    /// Whether the receiving end of a link that drops messages takes others.
    fn takes(&self, losing: &Losing) -> bool {
        !self.not_taking.iter().any(|end| end.is_of(losing))
    }

    /// Whether messages get through on all links.
    pub(crate) fn is_working(&self) -> bool {
        self.not_taking.is_empty()
            && self.missing_deadlines.is_empty()
            && self.short_of_memory.is_empty()
    }

    /// The troubles as text. Those whose messages do not get through come first.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> {
        let not_taking = self.not_taking.iter().map(|it| {
            let remedy = it.remedy();
            format!("But {it}: {remedy}.")
        });
        let missing = self.missing_deadlines.iter().map(|it| format!("But {it}."));
        let too_long = self.too_long.iter().map(|link| {
            format!("But {link}: raise max_len of the subscriber, or split the messages.")
        });
        let short_of_memory = self.short_of_memory.iter().map(|end| {
            format!(
                "But {end}: messages wait until there is memory. Free some, or raise the limits of the process."
            )
        });
        let losing = self.losing.iter().map(|it| match self.takes(it) {
            true => format!("Note: {it}: {}.", it.remedy()),
            false => format!("Note: {it}."),
        });
        let holding = self.holding.iter().map(|it| format!("Note: {it}."));
        let bad = not_taking
            .chain(missing)
            .chain(too_long)
            .chain(short_of_memory);
        bad.chain(losing).chain(holding)
    }
}

/// How long the node has been short of memory, if it is.
fn short_seconds(entry: &Entry) -> Option<f64> {
    let since = entry.short_since?;
    Some(hundredths(clock::now().since(since).as_secs_f64()))
}

/// `listener:scan did not get 2 messages of talker:scan, because they are longer than it accepts`
impl fmt::Display for TooLong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            sender,
            receiver,
            messages,
        } = self;
        let messages = Counted::new(*messages, "message");
        write!(
            f,
            "{receiver} did not get {messages} of {sender}, because they are longer than it accepts"
        )
    }
}

/// `listener:scan has been short of memory for 3 s on its link with talker:scan`
impl fmt::Display for ShortOfMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            interface,
            peer,
            seconds,
        } = self;
        write!(
            f,
            "{interface} has been short of memory for {seconds} s on its link with {peer}"
        )
    }
}
