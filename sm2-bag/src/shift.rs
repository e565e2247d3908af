//! Moving the times of a bag.

use mcap::records::Metadata;

use crate::clock::ClockRelation;
use crate::gap::Gap;
use crate::incident_record;
use crate::missing::MissingTopic;
use crate::written_by::WrittenBy;

/// A span to move times by, in nanoseconds; below 0 towards the past.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Shift(pub(crate) i128);

impl Shift {
    pub(crate) fn apply(self, time_ns: u64) -> u64 {
        let moved = i128::from(time_ns).saturating_add(self.0);
        u64::try_from(moved.max(0)).unwrap_or(u64::MAX)
    }

    /// The metadata record as it stands in a bag whose times have moved; `None` if that bag has another one.
    pub(crate) fn record(self, record: &Metadata) -> Option<Metadata> {
        let mut record = record.clone();
        if self.0 == 0 {
            return Some(record);
        }
        let times: &[&str] = match record.name.as_str() {
            ClockRelation::RECORD => return None,
            Gap::RECORD | MissingTopic::RECORD => &["from_ns", "to_ns"],
            WrittenBy::RECORD => &["since_ns"],
            incident_record::RECORD => &incident_record::TIMES,
            _ => &[],
        };
        for key in times {
            if let Some(time) = record.metadata.get_mut(*key)
                && let Ok(before) = time.parse()
            {
                *time = self.apply(before).to_string();
            }
        }
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::gap::GapReason;

    #[test]
    fn times_have_limits() {
        assert_eq!(Shift(5).apply(7), 12);
        assert_eq!(Shift(-5).apply(7), 2);
        assert_eq!(Shift(-8).apply(7), 0);
        assert_eq!(Shift(1).apply(u64::MAX), u64::MAX);
    }

    #[test]
    fn the_times_of_known_records_move() {
        let moved = |name: &str, metadata: BTreeMap<String, String>| {
            let name = name.to_owned();
            Shift(100).record(&Metadata { name, metadata })
        };
        let gap = Gap {
            publisher: "talker".to_owned(),
            from_ns: 1,
            to_ns: 2,
            messages: 3,
            reason: GapReason::Budget,
        };
        let record = moved(Gap::RECORD, gap.metadata("scan")).unwrap();
        let (topic, gap) = Gap::from_metadata(&record.metadata).unwrap();
        assert_eq!(
            (topic.as_str(), gap.from_ns, gap.to_ns, gap.messages),
            ("scan", 101, 102, 3)
        );
        let missing = MissingTopic {
            topic: "scan".to_owned(),
            reason: "no room".to_owned(),
            from_ns: 5,
            to_ns: None,
        };
        let record = moved(MissingTopic::RECORD, missing.metadata()).unwrap();
        let missing = MissingTopic::from_metadata(&record.metadata).unwrap();
        assert_eq!((missing.from_ns, missing.to_ns), (105, None));
        assert_eq!(moved(ClockRelation::RECORD, BTreeMap::new()), None);
        let other = BTreeMap::from([("from_ns".to_owned(), "1".to_owned())]);
        assert_eq!(moved("other", other.clone()).unwrap().metadata, other);
    }
}
