//! A receiving process of the demo: checks every byte.

use std::{io, os::fd::AsFd, time::Duration};

use sm2_io::clock;
use sm2_node::{Node, Sample};
use sm2_proto::Instant;

use super::{
    command_line::ProcessArguments,
    part::{DEPTH, Figures, ProcessEvent, Spot, TOPIC, send_event},
};
use crate::{
    error::DemoError,
    pattern,
    statistics::{Latencies, rate},
    waiting::drive,
};

/// The interval of reports.
const SECOND: Duration = Duration::from_secs(1);

/// Receives until standard input ends, and then the messages that have already arrived.
pub(crate) fn run(arguments: &ProcessArguments) -> Result<(), DemoError> {
    let node = Node::builder(&arguments.name)
        .socket(&arguments.socket)
        .connect()
        .map_err(DemoError::node)?;
    let subscriber = node
        .subscriber_builder::<[u8]>(TOPIC)
        .depth(DEPTH)
        .declare()
        .map_err(DemoError::node)?;
    let stdin = io::stdin();
    let fds = [subscriber.as_fd(), stdin.as_fd()];
    let mut counter = ReceptionCounter::new(arguments.size);
    send_event(&ProcessEvent::Ready).map_err(DemoError::Output)?;
    let mut ending = false;
    loop {
        match subscriber.try_recv().map_err(DemoError::node)? {
            Some(sample) => counter.take(&sample),
            None if ending => break,
            // All messages published before the end of standard input have arrived or are lost.
            None => ending = drive(&node, &fds, Some(counter.report_at))?[1],
        }
        counter.report()?;
    }
    send_event(&ProcessEvent::Done(counter.total())).map_err(DemoError::Output)
}

/// Counts of received messages.
struct ReceptionCounter {
    size_bytes: u64,
    figures: Figures,
    latencies: Latencies,
    /// The number in the last intact message.
    number: Option<u64>,
    first: Instant,
    last: Instant,
    report_at: Instant,
    reported: (Instant, u64),
}

impl ReceptionCounter {
    fn new(size_bytes: u64) -> Self {
        let now = clock::now();
        Self {
            size_bytes,
            figures: Figures::default(),
            latencies: Latencies::default(),
            number: None,
            first: now,
            last: now,
            report_at: now.after(SECOND),
            reported: (now, 0),
        }
    }

    fn take(&mut self, sample: &Sample<[u8]>) {
        let now = clock::now();
        if self.figures.messages == 0 {
            self.first = now;
        }
        self.last = now;
        self.figures.messages += 1;
        self.figures.lost += sample.lost();
        let latency = now.since(sample.source_time());
        self.latencies.record(latency.as_nanos() as u64);
        if let Err(offset) = self.check(sample) {
            self.figures.damaged += 1;
            self.figures.first_damage.get_or_insert(Spot {
                message: self.figures.messages,
                offset,
            });
        }
    }

    /// Compares every byte, and checks that the message is newer than the last one: an old message in
    /// memory has intact bytes, too. The error is the offset of the first difference.
    fn check(&mut self, message: &[u8]) -> Result<(), u64> {
        if message.len() as u64 != self.size_bytes {
            return Err(self.size_bytes.min(message.len() as u64));
        }
        let number = pattern::check(message).map_err(|damage| damage.offset as u64)?;
        if self
            .number
            .replace(number)
            .is_some_and(|last| number <= last)
        {
            return Err(0);
        }
        Ok(())
    }

    /// Reports the figures of the last second, when it is over.
    fn report(&mut self) -> Result<(), DemoError> {
        let now = clock::now();
        if now < self.report_at {
            return Ok(());
        }
        let (since, before) = self.reported;
        let passed = now.since(since).as_secs_f64();
        let figures = Figures {
            hz: (self.figures.messages - before) as f64 / passed,
            latency_us: self.latencies.take_second(),
            ..self.figures
        };
        self.reported = (now, self.figures.messages);
        self.report_at = now.after(SECOND);
        send_event(&ProcessEvent::Progress(figures)).map_err(DemoError::Output)
    }

    /// The figures of the whole run.
    fn total(&self) -> Figures {
        Figures {
            hz: rate(self.figures.messages, self.first, self.last),
            latency_us: self.latencies.total(),
            ..self.figures
        }
    }
}

#[cfg(test)]
mod tests;
