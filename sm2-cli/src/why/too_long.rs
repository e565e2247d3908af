//! Links on which messages were dropped because they are longer than the subscriber accepts.

use std::{collections::BTreeSet, fmt};

use serde::Serialize;
use sm2_proto::{EntityId, LinkId, domain::Domain as Mirror, text::Counted};

use crate::{connect::Session, sampling::Sampler, view::View};

/// A link whose sender has dropped messages that are longer than the other side accepts (SM2-QOS-008).
#[derive(Serialize)]
pub(super) struct TooLong {
    /// The interface that sends.
    sender: String,
    /// The interface that does not accept messages of this length.
    receiver: String,
    /// The number of messages.
    messages: u64,
}

impl TooLong {
    /// The links of these interfaces on which that happened. It reads the counters of their nodes.
    pub(super) fn find(session: &Session, domain: &Mirror, of: &[EntityId]) -> Vec<Self> {
        let view = View::new(domain);
        let links = of.iter().flat_map(|it| view.links_of(*it)).copied();
        let links: Vec<_> = links.collect();
        let nodes = links.iter().map(|link| link.offering.node).collect();
        // The verdict is complete without counters.
        let Ok(sample) = Sampler::new().look(&session.node, domain, &nodes) else {
            return Vec::new();
        };
        let mut seen: BTreeSet<LinkId> = BTreeSet::new();
        (links.iter())
            .filter(|link| seen.insert(link.link))
            .filter_map(|link| {
                let messages = sample.offering(domain, link)?.fates.too_long;
                (messages > 0).then(|| Self {
                    sender: view.title(link.offering),
                    receiver: view.title(link.demanding),
                    messages,
                })
            })
            .collect()
    }
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
