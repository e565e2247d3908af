//! The summary of a bag.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::damaged::DamagedPart;
use crate::gap::{Gap, GapReason};
use crate::missing::MissingTopic;
use crate::repeated::NotRepeated;
use crate::written_by::WrittenBy;

/// The summary of a bag: its topics, times and gaps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// The topics with their types, sorted by name.
    pub topics: Vec<TopicReport>,
    /// The topics that were not recorded for a time, in the order of these times. Of very many, some are not named.
    pub missing: Vec<MissingTopic>,
    /// The number of topics that were not recorded, those without a name included.
    pub not_recorded: u64,
    /// The parts that are damaged, as far as they were read; those of the bags that this one was copied from included.
    pub damaged: Vec<DamagedPart>,
    /// The `log_time` of the first message, in nanoseconds of the wall clock.
    pub start_ns: Option<u64>,
    /// The `log_time` of the last message, in nanoseconds of the wall clock.
    pub end_ns: Option<u64>,
    /// Whether the recording ended in order. Otherwise the bag was read up to its last chunk that is whole, and its
    /// counts are of that part.
    pub complete: bool,
    /// The recorder that is still writing the bag, if one is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub writer: Option<WrittenBy>,
}

impl Report {
    /// The summary of a bag that has these files. Later files repeat latched messages of earlier ones, so those of the
    /// first file count alone.
    #[must_use]
    pub fn of_files(files: &[Self]) -> Self {
        if let [file] = files {
            return file.clone();
        }
        let first = files.iter().filter(|it| it.start_ns.is_some());
        let first = first.min_by_key(|it| it.start_ns);
        let mut all = ReportBuilder::default();
        files.iter().for_each(|it| all.add_report(it));
        let mut report = all.finish_all(files.iter().all(|it| it.complete));
        for topic in &mut report.topics {
            let topics = first.iter().flat_map(|it| &it.topics);
            let mut same =
                topics.filter(|it| (&it.name, &it.r#type) == (&topic.name, &topic.r#type));
            let counts = same.next().map(|it| (it.repeated, it.not_repeated));
            (topic.repeated, topic.not_repeated) = counts.unwrap_or_default();
        }
        report.writer = files.iter().find_map(|it| it.writer.clone());
        report
    }
}

/// The type of the messages of a topic. Another type of the same name, with another hash, is another type.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct TopicType {
    /// Its name.
    pub name: String,
    /// Its hash, 16 hexadecimal digits. `None` in a bag of another program, which does not state it.
    pub hash: Option<String>,
}

/// A topic of a bag.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopicReport {
    /// The topic.
    pub name: String,
    /// The type of its messages.
    pub r#type: TopicType,
    /// The number of messages in the bag.
    pub messages: u64,
    /// The length of all their payloads, in bytes. `None` if only the index of a bag of another program was read, which
    /// does not have it.
    pub bytes: Option<u64>,
    /// The number of messages that are missing in the bag: the sum over all gaps.
    pub lost: u64,
    /// Where messages are missing.
    pub gaps: Vec<Gap>,
    /// The number of messages of latched publishers that the bag begins with, because they were published before it.
    /// They are not in `messages`.
    pub repeated: u64,
    /// The number of such messages that the bag has no room for.
    pub not_repeated: u64,
}

impl Report {
    /// The number of messages that are missing because they were longer than the recorder takes.
    #[must_use]
    pub fn too_long(&self) -> u64 {
        let gaps = self.topics.iter().flat_map(|it| &it.gaps);
        let too_long = gaps.filter(|it| it.reason == GapReason::TooLong);
        too_long.fold(0, |sum, it| sum.saturating_add(it.messages))
    }
}

/// The counts of one channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) messages: u64,
    pub(crate) bytes: u64,
}

impl Counts {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.channel";

    pub(crate) fn add(&mut self, len_bytes: usize) {
        self.messages += 1;
        self.bytes += len_bytes as u64;
    }

    pub(crate) fn metadata(self, channel: u16) -> BTreeMap<String, String> {
        [
            ("id", channel.to_string()),
            ("messages", self.messages.to_string()),
            ("bytes", self.bytes.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<(u16, Self)> {
        let counts = Self {
            messages: metadata.get("messages")?.parse().ok()?,
            bytes: metadata.get("bytes")?.parse().ok()?,
        };
        Some((metadata.get("id")?.parse().ok()?, counts))
    }
}

/// The number of topics that were not recorded and have no name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NotRecorded(pub(crate) u64);

impl NotRecorded {
    /// The name of its metadata record.
    pub(crate) const RECORD: &str = "sm2.not_recorded";

    pub(crate) fn metadata(self) -> BTreeMap<String, String> {
        [("topics".to_owned(), self.0.to_string())].into()
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self(metadata.get("topics")?.parse().ok()?))
    }
}

/// Extends the first and the last time of a bag by the time of a message.
pub(crate) fn widen(times: &mut Option<(u64, u64)>, time: u64) {
    let (from, to) = times.unwrap_or((time, time));
    *times = Some((from.min(time), to.max(time)));
}

/// Adds up the channels and gaps of a bag.
#[derive(Debug, Default)]
pub(crate) struct ReportBuilder {
    /// By topic and type.
    topics: BTreeMap<(String, TopicType), TopicReport>,
    /// The places of the last gaps of each topic, publisher and reason.
    last_gaps: BTreeMap<(String, String, GapReason), usize>,
    /// By the beginning of the time and the topic.
    missing: BTreeMap<(u64, String), MissingTopic>,
    /// The number of topics that were not recorded and have no name.
    unnamed: u64,
    damaged: Vec<DamagedPart>,
    /// The times of the bags that were added.
    times: Option<(u64, u64)>,
}

impl ReportBuilder {
    pub(crate) fn add_channel(&mut self, topic: &str, data: &TopicType, counts: Counts) {
        let report = self.topic(topic, data);
        // A hostile bag can claim any counts.
        report.messages = report.messages.saturating_add(counts.messages);
        report.bytes = report.bytes.map(|it| it.saturating_add(counts.bytes));
    }

    /// Removes the lengths of messages, which are not known.
    pub(crate) fn forget_bytes(&mut self) {
        let topics = self.topics.values_mut().filter(|it| it.messages > 0);
        topics.for_each(|it| it.bytes = None);
    }

    /// Adds a channel whose messages are repeated.
    pub(crate) fn add_repeated(&mut self, topic: &str, data: &TopicType, counts: Counts) {
        let report = self.topic(topic, data);
        report.repeated = report.repeated.saturating_add(counts.messages);
    }

    fn topic(&mut self, topic: &str, data: &TopicType) -> &mut TopicReport {
        let key = (topic.to_owned(), data.clone());
        self.topics.entry(key).or_insert_with(|| TopicReport {
            name: topic.to_owned(),
            r#type: data.clone(),
            bytes: Some(0),
            ..TopicReport::default()
        })
    }

    /// Adds a gap to the first type of its topic: a publisher whose messages are missing is a channel of the bag.
    pub(crate) fn add_gap(&mut self, topic: &str, gap: &Gap) {
        let first = (topic.to_owned(), TopicType::default());
        let Some((_, report)) = self.topics.range_mut(first..).next() else {
            return;
        };
        if report.name != topic {
            return;
        }
        report.lost = report.lost.saturating_add(gap.messages);
        let key = (topic.to_owned(), gap.publisher.clone(), gap.reason);
        let before = self
            .last_gaps
            .get(&key)
            .and_then(|at| report.gaps.get_mut(*at));
        if !before.is_some_and(|it| it.extend(gap)) {
            self.last_gaps.insert(key, report.gaps.len());
            report.gaps.push(gap.clone());
        }
    }

    /// Adds latched messages that the bag does not begin with. Their record has no hash: the first type of the name is
    /// theirs.
    pub(crate) fn add_not_repeated(&mut self, it: &NotRepeated) {
        let unknown = TopicType {
            name: it.data.clone(),
            hash: None,
        };
        let first = (it.topic.clone(), unknown.clone());
        let found = self.topics.range(first..).next();
        let found = found.filter(|((topic, data), _)| (topic, &data.name) == (&it.topic, &it.data));
        let data = found.map_or(unknown, |((_, data), _)| data.clone());
        let report = self.topic(&it.topic, &data);
        report.not_repeated = report.not_repeated.saturating_add(it.messages);
    }

    /// Adds a topic that was missing, or the end of that time.
    pub(crate) fn add_missing(&mut self, missing: &MissingTopic) {
        let key = (missing.from_ns, missing.topic.clone());
        self.missing.insert(key, missing.clone());
    }

    /// Adds topics that were not recorded and have no name.
    pub(crate) fn add_not_recorded(&mut self, topics: u64) {
        self.unnamed = self.unnamed.saturating_add(topics);
    }

    pub(crate) fn add_damaged(&mut self, part: &DamagedPart) {
        self.damaged.push(part.clone());
    }

    /// Adds another bag.
    pub(crate) fn add_report(&mut self, report: &Report) {
        for topic in &report.topics {
            let counts = Counts {
                messages: topic.messages,
                bytes: topic.bytes.unwrap_or_default(),
            };
            self.add_channel(&topic.name, &topic.r#type, counts);
            let sum = self.topic(&topic.name, &topic.r#type);
            sum.bytes = sum.bytes.filter(|_| topic.bytes.is_some());
            sum.repeated = sum.repeated.saturating_add(topic.repeated);
            sum.not_repeated = sum.not_repeated.saturating_add(topic.not_repeated);
            for gap in &topic.gaps {
                self.add_gap(&topic.name, gap);
            }
        }
        report.missing.iter().for_each(|it| self.add_missing(it));
        let named = report.missing.len() as u64;
        self.add_not_recorded(report.not_recorded.saturating_sub(named));
        report.damaged.iter().for_each(|it| self.add_damaged(it));
        for time in report.start_ns.into_iter().chain(report.end_ns) {
            widen(&mut self.times, time);
        }
    }

    /// The sum of the bags that were added.
    pub(crate) fn finish_all(self, complete: bool) -> Report {
        let times = self.times;
        self.finish(times, complete)
    }

    pub(crate) fn finish(self, times: Option<(u64, u64)>, complete: bool) -> Report {
        let missing: Vec<_> = self.missing.into_values().collect();
        Report {
            topics: self.topics.into_values().collect(),
            not_recorded: self.unnamed.saturating_add(missing.len() as u64),
            missing,
            damaged: self.damaged,
            start_ns: times.map(|it| it.0),
            end_ns: times.map(|it| it.1),
            complete,
            writer: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bag can claim any numbers.
    #[test]
    fn sums_have_a_limit() {
        let counts = Counts {
            messages: u64::MAX,
            bytes: u64::MAX,
        };
        let gap = |publisher: &str, from_ns| Gap {
            publisher: publisher.to_owned(),
            from_ns,
            to_ns: from_ns + 1,
            messages: u64::MAX,
            reason: GapReason::Budget,
        };
        let mut report = ReportBuilder::default();
        for data in ["a", "b", "b"] {
            let data = TopicType {
                name: data.to_owned(),
                hash: None,
            };
            report.add_channel("topic", &data, counts);
        }
        for (publisher, from_ns) in [("x", 0), ("y", 0), ("x", 1), ("y", 5), ("x", 2)] {
            report.add_gap("topic", &gap(publisher, from_ns));
        }
        report.add_gap("other", &gap("x", 3));
        let report = report.finish(None, true);
        assert_eq!(report.topics[1].messages, u64::MAX);
        // The gaps are those of the first type, and only gaps that follow each other become one.
        let [first, second] = &report.topics[..] else {
            panic!("{report:?}");
        };
        assert_eq!((first.lost, &second.gaps[..]), (u64::MAX, &[][..]));
        let gaps = first
            .gaps
            .iter()
            .map(|it| (&*it.publisher, it.from_ns, it.to_ns));
        assert_eq!(
            gaps.collect::<Vec<_>>(),
            [("x", 0, 3), ("y", 0, 1), ("y", 5, 6)]
        );
    }
}
