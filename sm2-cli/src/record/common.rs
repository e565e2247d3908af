//! The parts that a recording and a black box share.

use std::fmt;

use sm2_bag::Progress;
use sm2_proto::text::Counted;

use crate::size::Size;

/// A new name with the date and the time, in UTC.
pub(super) fn new_name(stem: &str) -> String {
    let now = jiff::Timestamp::now();
    format!("{stem}-{}", now.strftime("%Y-%m-%d-%H%M%S"))
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
        match is_disk_full {
            true => f.write_str(", DISK FULL: messages are dropped"),
            false => Ok(()),
        }
    }
}
