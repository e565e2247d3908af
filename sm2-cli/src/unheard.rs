//! Messages that were published while no subscriber was linked.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, Kind, domain::Domain as Mirror, text::Counted};

use crate::{connect::Session, sampling::Sampler, view::View};

/// A publisher some of whose messages no link carried.
#[derive(Serialize)]
pub(crate) struct Unheard {
    /// The publisher.
    publisher: String,
    /// The number of these messages.
    messages: u64,
}

impl Unheard {
    /// The publishers among these interfaces that have published to nobody. Reads the counters of their nodes.
    pub(crate) fn find(session: &Session, domain: &Mirror, of: &[EntityId]) -> Vec<Self> {
        let view = View::new(domain);
        let kind = |it: &EntityId| Some(domain.interface(*it)?.contract.kind());
        let publishers = of.iter().filter(|it| kind(it) == Some(Kind::Publisher));
        let publishers: Vec<_> = publishers.copied().collect();
        let nodes = publishers.iter().map(|it| it.node).collect();
        // All else is complete without counters.
        let Ok(sample) = Sampler::new().look(&session.node, domain, &nodes) else {
            return Vec::new();
        };
        let found = publishers.into_iter().filter_map(|publisher| {
            let messages = sample.interface(domain, publisher)?.unheard;
            (messages > 0).then(|| Self {
                publisher: view.title(publisher),
                messages,
            })
        });
        found.collect()
    }
}

/// `talker:stop published 2 messages while no subscriber was linked`
impl fmt::Display for Unheard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            publisher,
            messages,
        } = self;
        let messages = Counted::new(*messages, "message");
        write!(
            f,
            "{publisher} published {messages} while no subscriber was linked"
        )
    }
}
