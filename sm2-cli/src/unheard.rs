//! Messages that were published while no subscriber was linked.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, text::Counted};

use crate::{sampling::Sample, view::View};

/// A publisher some of whose messages no link carried.
#[derive(Serialize)]
pub(crate) struct Unheard {
    /// The publisher.
    publisher: String,
    /// The number of these messages.
    messages: u64,
}

impl Unheard {
    /// The publishers among these interfaces that have published to nobody.
    pub(crate) fn find(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Vec<Self> {
        let found = sample.counted(view, of, |entry| entry.unheard);
        let found = found.map(|(publisher, messages)| Self {
            publisher,
            messages,
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
