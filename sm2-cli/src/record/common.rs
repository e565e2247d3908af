//! The parts that a recording and a black box share.

use std::{fmt, time::Duration};

use sm2_bag::Progress;
use sm2_io::clock;
use sm2_proto::{Contract, Instant, domain::Domain as Mirror, text::Counted};

use crate::{names::pattern_hint, size::Size};

/// A new name with the date and the time, in UTC.
pub(super) fn new_name(stem: &str) -> String {
    let now = jiff::Timestamp::now();
    format!("{stem}-{}", now.strftime("%Y-%m-%d-%H%M%S"))
}

/// Said of topics and patterns without a publisher while one may still come.
pub(super) const SO_FAR: &str = "so far: it is recorded when it comes";
/// After this time, topics and patterns without a publisher are named.
const UNMATCHED_AFTER: Duration = Duration::from_secs(3);

/// Names topics and patterns that have no publisher: some time after the start, and at the end.
pub(super) struct Unmatched {
    at: Option<Instant>,
}

impl Unmatched {
    pub(super) fn new() -> Self {
        Self {
            at: Some(clock::now().after(UNMATCHED_AFTER)),
        }
    }

    /// The time until they are named, or until this time.
    pub(super) fn left(&self, left: Duration) -> Duration {
        let due = self.at.map(|it| it.since(clock::now()));
        due.map_or(left, |it| it.min(left))
    }

    /// Whether the time has come, once.
    pub(super) fn is_due(&mut self) -> bool {
        self.at.take_if(|it| clock::now() >= *it).is_some()
    }
}

/// Names topics and patterns without a publisher.
pub(super) fn say_unmatched(unmatched: &[String], domain: &Mirror, when: &str) {
    let publishers = || {
        let all = domain.interfaces();
        let publishers = all.filter(|it| matches!(it.contract, Contract::Publisher { .. }));
        publishers.map(|it| it.contract.name())
    };
    for text in unmatched {
        let hint = pattern_hint(text, publishers());
        stderr_line!("sm2: no publisher of {text} {when}{hint}");
    }
}

/// The progress, as it is shown on a terminal.
pub(super) struct Shown(pub(super) Progress);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Progress {
            topics,
            not_recorded,
            messages,
            bytes,
            lost,
            too_long,
            waiting_bytes,
            is_disk_full,
            missing: _,
        } = self.0;
        write!(
            f,
            "{}: {} ({}), lost {lost}, {} waiting for the disk",
            Counted::new(topics as u64, "topic"),
            Counted::new(messages, "message"),
            Size(bytes),
            Size(waiting_bytes)
        )?;
        if not_recorded > 0 {
            let topics = Counted::new(not_recorded as u64, "topic");
            write!(f, ", {topics} not recorded")?;
        }
        if too_long > 0 {
            let messages = Counted::new(too_long, "message");
            write!(f, ", {messages} longer than --max-len")?;
        }
        match is_disk_full {
            true => f.write_str(", DISK FULL: messages are dropped"),
            false => Ok(()),
        }
    }
}
