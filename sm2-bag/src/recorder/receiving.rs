//! Taking the messages of a topic, and passing them to the writer.

use sm2_node::{Sample, Timer};
use sm2_proto::Instant;

use super::polled::Frequency;
use super::topic::{Taken, Wait};
use super::{BURST, Event, HELD_MAX, Recorder};
use crate::error::RecordError;
use crate::gap::GapReason;
use crate::queue::{HeldBy, Item, Payload};
use crate::writer::COPY_MAX_BYTES;

impl Recorder<'_> {
    /// Takes messages of a topic that may have some. The set reports it again if there are more.
    pub(super) fn receive(&mut self, number: usize) -> Result<(), RecordError> {
        let count = self.take(number, BURST)?;
        let topic = &mut self.topics[number];
        let (before, now) = (topic.wait, (self.options.monotonic_clock)());
        let Some(frequency) = Frequency::of(topic, count, now) else {
            return Ok(());
        };
        for (interval, polled) in self.polled.iter_mut().enumerate() {
            if !polled.add(number, topic, frequency, now) {
                continue;
            }
            if let Wait::Message(key) = before {
                self.set.remove(key);
            }
            if polled.timer.is_none() {
                let timer = Timer::every(polled.interval);
                polled.timer = Some(self.set.add_timer(timer, Event::Poll(interval)));
            }
            break;
        }
        Ok(())
    }

    /// Takes the messages of a topic that one call finds, at most `most`. Returns their number.
    pub(super) fn take(&mut self, number: usize, most: usize) -> Result<usize, RecordError> {
        let topic = &mut self.topics[number];
        let mut most = most;
        if topic.is_reliable {
            if !self.queue.has_room(HeldBy(number), HELD_MAX) {
                // Its messages stay with their publishers, which wait.
                if let Wait::Message(key) = std::mem::replace(&mut topic.wait, Wait::Room) {
                    self.set.remove(key);
                }
                return Ok(0);
            }
            // Each further message needs room, too.
            most = 1;
        }
        let mut samples = std::mem::take(&mut self.samples);
        let taken = topic.take(&mut samples, most);
        for sample in samples.drain(..) {
            self.record(number, sample, (self.options.monotonic_clock)());
        }
        self.samples = samples;
        Ok(taken?)
    }

    /// Passes a message that came at this time to the writer, or counts it as missing.
    pub(super) fn record(&mut self, number: usize, sample: Sample<[u8]>, at: Instant) {
        self.count_lost(number, &sample, at);
        let topic = &mut self.topics[number];
        let now = self.clock.wall_at(at);
        let Some(taken) = topic.describe(&self.node, &sample, &self.clock, now) else {
            return;
        };
        let held_by = HeldBy(number);
        let len_bytes = sample.len() as u64;
        let admitted = match topic.is_reliable {
            _ if len_bytes > self.options.max_len_bytes => Err(GapReason::TooLong),
            true => Ok(()),
            false => self.queue.admit(sample.len()),
        };
        if let Err(reason) = admitted {
            self.lost += 1;
            if reason == GapReason::TooLong {
                self.too_long += 1;
                topic.log_too_long(len_bytes);
            }
            topic.count_dropped(&taken, reason);
            self.has_gaps = true;
            return;
        }
        topic.mark_recorded(&taken, &self.queue);
        let Taken { source, times, .. } = taken;
        if sample.len() <= COPY_MAX_BYTES {
            return self.queue.push_copy(source, times, &sample);
        }
        self.queue.push(Item::Message {
            source,
            times,
            // While the disk stalls, the publisher gets its slots back. One with little memory gets them at once.
            payload: match !topic.losses.is_pool_short && self.queue.held(held_by) < HELD_MAX {
                true => Payload::Held(sample, held_by),
                false => Payload::Owned(sample.to_vec()),
            },
        });
    }
}
