//! Troubles on links, as the counters of their two ends tell.

use std::{collections::BTreeSet, fmt};

use serde::Serialize;
use sm2_io::clock;
use sm2_proto::{EntityId, LinkId, counters::Entry, domain::LinkView, text::Counted};

use crate::{
    sampling::{Sample, hundredths},
    view::View,
};

/// The troubles on the links of some interfaces.
#[derive(Default, Serialize)]
pub(super) struct LinkTroubles {
    /// The links that dropped messages for their length.
    too_long: Vec<TooLong>,
    /// The ends of links whose nodes are short of memory.
    short_of_memory: Vec<ShortOfMemory>,
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
    /// The troubles on the links of these interfaces. `sample` has the counters of the nodes at both ends.
    pub(super) fn find(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Self {
        let mut troubles = Self::default();
        let mut seen: BTreeSet<LinkId> = BTreeSet::new();
        let links = of.iter().flat_map(|it| view.links_of(*it));
        for link in links.filter(|link| seen.insert(link.link)) {
            troubles.add(view, sample, link);
        }
        troubles
    }

    fn add(&mut self, view: &View<'_>, sample: &Sample, link: &LinkView) {
        let [offering, demanding] = [link.offering, link.demanding].map(|it| view.title(it));
        let offers = sample.offering(view.domain, link);
        let demands = sample.demanding(view.domain, link);
        let messages = offers.map_or(0, |entry| entry.fates.too_long);
        if messages > 0 {
            self.too_long.push(TooLong {
                sender: offering.clone(),
                receiver: demanding.clone(),
                messages,
            });
        }
        let ends = [
            (offers, &offering, &demanding),
            (demands, &demanding, &offering),
        ];
        for (entry, interface, peer) in ends {
            if let Some(seconds) = entry.and_then(short_seconds) {
                self.short_of_memory.push(ShortOfMemory {
                    interface: interface.clone(),
                    peer: peer.clone(),
                    seconds,
                });
            }
        }
    }

    /// The troubles as text.
    pub(super) fn lines(&self) -> impl Iterator<Item = String> {
        let too_long = self.too_long.iter().map(|link| {
            format!("But {link}: raise max_len of the subscriber, or split the messages.")
        });
        let short_of_memory = self.short_of_memory.iter().map(|end| {
            format!(
                "But {end}: messages wait until there is memory. Free some, or raise the limits of the process."
            )
        });
        too_long.chain(short_of_memory)
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
