//! Topics that a recording should have had, and has not.

use std::collections::BTreeMap;

use serde::Serialize;

/// A topic that was not recorded for a time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MissingTopic {
    /// The topic, or a pattern that no topic has matched.
    pub topic: String,
    /// Why it was not recorded.
    pub reason: String,
    /// Since when, in nanoseconds of the wall clock.
    pub from_ns: u64,
    /// When recording it began, or the topic had no publisher any more, in nanoseconds of the wall clock; `None` if
    /// neither was the case when the recording ended.
    pub to_ns: Option<u64>,
}

impl MissingTopic {
    /// The name of its metadata records: one when it begins to be missing, and one at the end of that time.
    pub(crate) const RECORD: &str = "sm2.missing";

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        let to_ns = self.to_ns.map(|it| ("to_ns", it.to_string()));
        let all = [
            ("topic", self.topic.clone()),
            ("reason", self.reason.clone()),
            ("from_ns", self.from_ns.to_string()),
        ];
        let all = all.into_iter().chain(to_ns);
        all.map(|(key, value)| (key.to_owned(), value)).collect()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            topic: metadata.get("topic")?.clone(),
            reason: metadata.get("reason")?.clone(),
            from_ns: metadata.get("from_ns")?.parse().ok()?,
            to_ns: match metadata.get("to_ns") {
                Some(it) => Some(it.parse().ok()?),
                None => None,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_the_whole_time() {
        for to_ns in [None, Some(3)] {
            let missing = MissingTopic {
                topic: "scan".to_owned(),
                reason: "no room".to_owned(),
                from_ns: 2,
                to_ns,
            };
            let read = MissingTopic::from_metadata(&missing.metadata());
            assert_eq!(read, Some(missing));
        }
    }
}
