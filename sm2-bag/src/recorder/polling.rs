//! When a recorder polls.

use super::{BURST, Recorder};
use crate::error::RecordError;

impl Recorder<'_> {
    /// Takes the messages of all frequent topics.
    pub(super) fn poll_all(&mut self) -> Result<(), RecordError> {
        (0..self.polled.len()).try_for_each(|interval| self.poll(interval))
    }

    /// Takes the messages of the topics with the interval of this number.
    pub(super) fn poll(&mut self, interval: usize) -> Result<(), RecordError> {
        let now = (self.options.monotonic_clock)();
        let polled = &mut self.polled[interval];
        let ended = polled.poll(&mut self.topics, BURST, now);
        let mut found = polled.take_found();
        if polled.is_empty()
            && let Some(timer) = polled.timer.take()
        {
            self.set.remove(timer);
        }
        for message in found.drain(..) {
            self.record(message.topic, message.sample, message.at);
        }
        self.polled[interval].keep(found);
        for number in ended? {
            self.wait_for(number)?;
        }
        Ok(())
    }
}
