//! Messages that a bag does not have.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer};
use sm2_proto::link::Fate;

/// Messages of one publisher that were published during a recording, and that the bag does not have.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Gap {
    /// The node that published them.
    pub publisher: String,
    /// The `log_time` of the message before the gap; of the first message after the gap, if there is none before.
    pub from_ns: u64,
    /// The `log_time` when the gap was noticed.
    pub to_ns: u64,
    /// The number of messages.
    pub messages: u64,
    /// Why they are missing.
    pub reason: GapReason,
}

/// Why messages are missing in a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GapReason {
    /// Newer messages of the publisher displaced them before the recorder took them (SM2-QOS-001).
    Displaced,
    /// The recorder dropped them, because its memory for messages that wait for the disk was used up.
    Budget,
    /// The recorder dropped them, because the disk was full.
    DiskFull,
    /// They were in a damaged part of the file that this bag was copied from.
    Damaged,
    /// They were longer than the recorder [takes](crate::Options::max_len_bytes).
    TooLong,
    /// The publisher did not send them for this reason (SM2-QOS-006), or they were [expired](Fate::Expired).
    Unsent(Fate),
}

impl GapReason {
    /// The reasons why the publisher did not send a message, but for those that have another name here:
    /// overwritten messages are [displaced](Self::Displaced), and the recorder takes messages of any length.
    pub(crate) fn unsent() -> impl Iterator<Item = Fate> {
        let fates = Fate::ALL.into_iter().filter(|it| it.is_unsent());
        fates.filter(|it| !matches!(it, Fate::Overwritten | Fate::TooLong))
    }

    fn all() -> impl Iterator<Item = Self> {
        let own = [
            Self::Displaced,
            Self::Budget,
            Self::DiskFull,
            Self::Damaged,
            Self::TooLong,
        ];
        own.into_iter().chain(Self::unsent().map(Self::Unsent))
    }

    const fn as_str(self) -> &'static str {
        match self {
            Self::Displaced => "displaced",
            Self::Budget => "budget",
            Self::DiskFull => "disk_full",
            Self::Damaged => "damaged",
            Self::TooLong => "too_long",
            Self::Unsent(fate) => fate.as_str(),
        }
    }
}

/// The name, such as `disk_full`.
impl Serialize for GapReason {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl Gap {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.gap";

    /// Extends this gap by the next one, if no message of the publisher was recorded between them. Returns whether it
    /// did.
    pub(crate) fn extend(&mut self, next: &Self) -> bool {
        let continues = self.publisher == next.publisher
            && self.reason == next.reason
            && next.from_ns <= self.to_ns;
        if continues {
            self.to_ns = self.to_ns.max(next.to_ns);
            self.messages = self.messages.saturating_add(next.messages);
        }
        continues
    }

    /// The content of the metadata record of a gap in this topic.
    pub(crate) fn metadata(&self, topic: &str) -> BTreeMap<String, String> {
        let Self {
            publisher,
            from_ns,
            to_ns,
            messages,
            reason,
        } = self;
        [
            ("topic", topic.to_owned()),
            ("publisher", publisher.clone()),
            ("from_ns", from_ns.to_string()),
            ("to_ns", to_ns.to_string()),
            ("messages", messages.to_string()),
            ("reason", reason.as_str().to_owned()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    /// The topic and the gap of a metadata record.
    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<(String, Self)> {
        let number = |key| metadata.get(key)?.parse().ok();
        let reason = metadata.get("reason")?;
        let gap = Self {
            publisher: metadata.get("publisher")?.clone(),
            from_ns: number("from_ns")?,
            to_ns: number("to_ns")?,
            messages: number("messages")?,
            reason: GapReason::all().find(|it| it.as_str() == reason)?,
        };
        Some((metadata.get("topic")?.clone(), gap))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(from_ns: u64, to_ns: u64, reason: GapReason) -> Gap {
        Gap {
            publisher: "camera".to_owned(),
            from_ns,
            to_ns,
            messages: 2,
            reason,
        }
    }

    #[test]
    fn a_record_has_the_whole_gap() {
        for reason in GapReason::all() {
            let gap = gap(1, 2, reason);
            let read = Gap::from_metadata(&gap.metadata("image"));
            assert_eq!(read, Some(("image".to_owned(), gap)));
        }
        let mut metadata = gap(1, 2, GapReason::Budget).metadata("image");
        metadata.insert("reason".to_owned(), "weather".to_owned());
        assert_eq!(Gap::from_metadata(&metadata), None);
    }

    #[test]
    fn a_gap_grows_until_a_message_was_recorded() {
        let mut first = gap(10, 20, GapReason::Budget);
        assert!(first.extend(&gap(10, 30, GapReason::Budget)));
        assert_eq!((first.from_ns, first.to_ns, first.messages), (10, 30, 4));
        assert!(!first.extend(&gap(31, 40, GapReason::Budget)));
        assert!(!first.extend(&gap(30, 40, GapReason::Displaced)));
        assert_eq!(first.messages, 4);
    }
}
