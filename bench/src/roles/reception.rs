//! The handler of a subscriber: checks each message, and counts.

use crate::{
    clock::now_ns,
    job::{Read, Reception},
    payload::{COUNTED, Header, Torn, check, peek},
    peers::{Flow, Handler},
    stats::Durations,
};

/// Messages between two readings of the clock when messages carry no times. Reading the clock for
/// each of them would take longer than receiving it.
const CLOCK_EACH: u64 = 256;

/// Counts of received messages, and their latencies.
pub(super) struct ReceptionCounter {
    read: Read,
    counted: u64,
    torn: u64,
    stale: u64,
    /// The number of the last message.
    last: Option<u64>,
    span: Span,
    latencies: Durations,
    handovers: Durations,
}

/// The time from the first counted message to the last one whose time was read from the clock.
#[derive(Clone, Copy, Default)]
struct Span {
    first_ns: u64,
    last_ns: u64,
    messages: u64,
}

impl Span {
    fn hz(self) -> f64 {
        match self.last_ns.saturating_sub(self.first_ns) {
            0 => 0.0,
            ns => (self.messages - 1) as f64 * 1e9 / ns as f64,
        }
    }
}

impl ReceptionCounter {
    pub(super) fn new(read: Read) -> Self {
        Self {
            read,
            counted: 0,
            torn: 0,
            stale: 0,
            last: None,
            span: Span::default(),
            latencies: Durations::with_capacity(4_096),
            handovers: Durations::with_capacity(4_096),
        }
    }

    pub(super) fn reception(&self) -> Reception {
        Reception {
            counted: self.counted,
            torn: self.torn,
            stale: self.stale,
            hz: self.span.hz(),
            latency_ns: self.latencies.clone().spread(),
            handover_ns: self.handovers.clone().spread(),
        }
    }

    /// Counts a message that arrived at `in_hand_ns`.
    fn count(&mut self, header: Header, in_hand_ns: u64) {
        self.counted += 1;
        let stamped = header.start_ns != 0;
        if !stamped && self.counted % CLOCK_EACH != 1 {
            return;
        }
        let now = now_ns();
        if self.counted == 1 {
            self.span.first_ns = now;
        }
        self.span.last_ns = now;
        self.span.messages = self.counted;
        if stamped {
            self.latencies.record(now.saturating_sub(header.start_ns));
            let handover = in_hand_ns.saturating_sub(header.handed_ns);
            self.handovers.record(handover);
        }
    }
}

impl Handler for ReceptionCounter {
    fn wants(&self) -> Read {
        self.read
    }

    fn message(&mut self, message: &[u8]) -> Flow {
        let Ok(first) = peek(message) else {
            self.torn += 1;
            return Flow::Continue;
        };
        let in_hand_ns = if first.start_ns == 0 { 0 } else { now_ns() };
        let read = match self.read {
            Read::Full => check(message),
            Read::Header => Ok(first),
        };
        match read {
            Ok(header) if self.last.is_some_and(|last| header.number <= last) => self.stale += 1,
            Ok(header) => self.last = Some(header.number),
            Err(Torn) => self.torn += 1,
        }
        if first.flags & COUNTED != 0 {
            self.count(first, in_hand_ns);
        }
        Flow::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::ReceptionCounter;
    use crate::{
        job::Read,
        payload::{COUNTED, Header, fill},
        peers::{Flow, Handler},
    };

    fn message(number: u64, flags: u64, start_ns: u64) -> Vec<u8> {
        let mut message = vec![0; 128];
        let header = Header {
            number,
            flags,
            start_ns,
            handed_ns: start_ns,
        };
        fill(header, &mut message);
        message
    }

    #[test]
    fn torn_stale_and_uncounted_messages_are_told_apart() {
        let mut counter = ReceptionCounter::new(Read::Full);
        let mut torn = message(5, COUNTED, 1);
        torn[100] ^= 1;
        for message in [
            message(1, 0, 1),
            message(2, COUNTED, 1),
            message(2, COUNTED, 1),
            torn,
            message(3, COUNTED, 1),
            vec![1; 7],
        ] {
            assert_eq!(counter.message(&message), Flow::Continue);
        }
        let reception = counter.reception();
        assert_eq!((reception.torn, reception.stale), (2, 1));
        assert_eq!((reception.counted, reception.latency_ns.count), (4, 4));
        assert!(reception.hz > 0.0);
    }

    #[test]
    fn who_reads_headers_sees_no_torn_body() {
        let mut counter = ReceptionCounter::new(Read::Header);
        let mut torn = message(5, COUNTED, 1);
        torn[100] ^= 1;
        let _ = counter.message(&torn);
        assert_eq!(counter.reception().torn, 0);
    }

    #[test]
    fn messages_without_a_stamp_have_a_rate_and_no_latency() {
        let mut counter = ReceptionCounter::new(Read::Full);
        for number in 0..=512 {
            let _ = counter.message(&message(number, COUNTED, 0));
        }
        let reception = counter.reception();
        assert_eq!((reception.counted, reception.latency_ns.count), (513, 0));
        assert!(reception.hz > 0.0);
    }
}
