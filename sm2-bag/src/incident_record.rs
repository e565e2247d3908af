//! The metadata record that says why a black box wrote a bag.

/// Its name.
pub(crate) const RECORD: &str = "sm2.incident";
/// The keys of the times of the trigger and of the bag, in nanoseconds of the wall clock.
pub(crate) const TIMES: [&str; 3] = [AT, FROM, TO];

pub(crate) const AT: &str = "time_ns";
pub(crate) const FROM: &str = "from_ns";
pub(crate) const TO: &str = "to_ns";
