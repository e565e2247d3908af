//! Sets of messages with the same time.

use super::queues::{Queues, Unused};

/// Drops the messages that cannot be part of a set any more, and makes sets of equal times.
///
/// The times of an input do not decrease, so no input brings a message before its oldest one that is held or, if it
/// holds none, before its newest one. The latest of these times is a lower bound for the time of the next set.
pub(super) fn process(queues: &mut Queues) {
    loop {
        let inputs = 0..queues.inputs();
        let bounds = inputs.map(|it| queues.time(it, 0).or_else(|| queues.newest(it)));
        let Some(bound) = bounds.flatten().max() else {
            return;
        };
        let mut has_dropped = false;
        for input in 0..queues.inputs() {
            while queues.time(input, 0).is_some_and(|time| time < bound) {
                queues.drop_oldest(input, Unused::Unmatched);
                has_dropped = true;
            }
        }
        if has_dropped {
            continue;
        }
        if (0..queues.inputs()).any(|it| queues.time(it, 0) != Some(bound)) {
            return;
        }
        queues.take_set();
    }
}
