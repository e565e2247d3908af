//! Repeated messages: those that a bag begins with although they were published before it.

use std::collections::BTreeMap;

use mcap::Channel;

/// The key in the metadata of a channel whose messages are repeated.
const KEY: &str = "sm2.repeated";
const YES: &str = "true";

/// Whether the messages of a channel are repeated.
pub(crate) fn is_repeated(channel: &Channel<'_>) -> bool {
    channel.metadata.get(KEY).is_some_and(|it| it == YES)
}

/// Makes the metadata of a channel those of a channel with repeated messages.
pub(crate) fn mark_repeated(metadata: &mut BTreeMap<String, String>) {
    metadata.insert(KEY.to_owned(), YES.to_owned());
}

/// Latched messages of a publisher that a bag should begin with, and has not, because there was no room for them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NotRepeated {
    pub(crate) topic: String,
    pub(crate) publisher: String,
    /// The name of the type.
    pub(crate) data: String,
    pub(crate) messages: u64,
}

impl NotRepeated {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.not_repeated";

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        [
            ("topic", self.topic.clone()),
            ("publisher", self.publisher.clone()),
            ("type", self.data.clone()),
            ("messages", self.messages.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            topic: metadata.get("topic")?.clone(),
            publisher: metadata.get("publisher")?.clone(),
            data: metadata.get("type")?.clone(),
            messages: metadata.get("messages")?.parse().ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_all_of_it() {
        let not_repeated = NotRepeated {
            topic: "map".to_owned(),
            publisher: "mapper".to_owned(),
            data: "text".to_owned(),
            messages: 2,
        };
        let read = NotRepeated::from_metadata(&not_repeated.metadata());
        assert_eq!(read, Some(not_repeated));
    }
}
