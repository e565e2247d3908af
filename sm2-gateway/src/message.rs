//! A message between its origin's gateway and a peer.

use std::time::Duration;

use bytes::Bytes;
use sm2_proto::{
    Instant,
    gateway::{Header, HeaderKind, OfferId},
};

/// A message of a topic: its bytes, and the values that the gateway of its origin gave it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its number among the messages of its topic and origin.
    pub sequence: u64,
    /// The time of its publication, on the clock of this machine.
    pub published_at: Instant,
    /// Its bytes.
    pub payload: Bytes,
}

impl Message {
    /// A message that arrives with this age. Its time of publication is earlier by the age, so
    /// that the age grows while this gateway keeps the message.
    //= SM2-GWM-007
    pub(crate) fn arrived(now: Instant, sequence: u64, age: Duration, payload: Bytes) -> Self {
        let age_ns = u64::try_from(age.as_nanos()).unwrap_or(u64::MAX);
        Self {
            sequence,
            published_at: Instant(now.0.saturating_sub(age_ns)),
            payload,
        }
    }

    /// The header of a message that starts now.
    pub(crate) fn header(&self, offer: OfferId, now: Instant) -> Header {
        let age = now.since(self.published_at).as_nanos();
        Header {
            kind: HeaderKind::Message {
                sequence: self.sequence,
                age_ns: u64::try_from(age).unwrap_or(u64::MAX),
            },
            offer,
            len: self.payload.len() as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    //= SM2-GWM-007 test
    #[test]
    fn the_age_grows_while_a_gateway_keeps_a_message() {
        let age = |now, age_ns, later| {
            let age = Duration::from_nanos(age_ns);
            let message = Message::arrived(Instant(now), 7, age, Bytes::from_static(b"abc"));
            message.header(OfferId(1), Instant(later))
        };
        let kind = |age_ns| HeaderKind::Message {
            sequence: 7,
            age_ns,
        };
        let header = age(1_000, 300, 1_500);
        assert_eq!((header.kind, header.len), (kind(800), 3));
        // An age beyond the start of the clock.
        assert_eq!(age(1_000, u64::MAX, 1_500).kind, kind(1_500));
    }
}
