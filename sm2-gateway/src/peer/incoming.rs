//! Payloads that arrive on streams: a header, as many bytes as it states, and the end of the stream.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::StreamId;
use sm2_proto::{
    Instant,
    gateway::{HEADER_LEN, Header, HeaderKind, PeerViolation, PeerViolationKind},
    violation,
};

use super::limits::Limits;
use crate::tally::Whose;

/// The streams whose payloads have not arrived completely.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    streams: BTreeMap<StreamId, Stream>,
    /// The bytes that have arrived of all these payloads.
    held_bytes: u64,
}

#[derive(Debug)]
struct Stream {
    head: Vec<u8>,
    header: Option<Header>,
    body: Vec<u8>,
    /// The time of the last arrival.
    moved: Instant,
}

/// The result of the arrival of bytes.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// There is nothing to do yet.
    More,
    /// The header is complete. The session decides whether its payload is read.
    Header(Header),
    /// The payload exceeds the limits.
    TooMuch,
}

impl Incoming {
    /// Adds bytes of a stream.
    //= SM2-GWM-011
    pub(super) fn push(
        &mut self,
        id: StreamId,
        mut bytes: &[u8],
        now: Instant,
        limits: &Limits,
    ) -> Result<Progress, PeerViolation> {
        let stream = self.streams.entry(id).or_insert_with(|| Stream {
            head: Vec::with_capacity(HEADER_LEN),
            header: None,
            body: Vec::new(),
            moved: now,
        });
        stream.moved = now;
        let mut progress = Progress::More;
        let header = match stream.header {
            Some(header) => header,
            None => {
                let missing = HEADER_LEN - stream.head.len();
                let (head, rest) = bytes.split_at(missing.min(bytes.len()));
                stream.head.extend_from_slice(head);
                bytes = rest;
                let Ok(head) = <&[u8; HEADER_LEN]>::try_from(&stream.head[..]) else {
                    return Ok(Progress::More);
                };
                let header = Header::from_bytes(head)?;
                stream.header = Some(header);
                progress = Progress::Header(header);
                header
            }
        };
        let len = (stream.body.len() + bytes.len()) as u64;
        if len > header.len {
            return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"));
        }
        self.held_bytes += bytes.len() as u64;
        if header.len > limits.message_bytes || self.held_bytes > limits.memory_bytes {
            self.held_bytes -= bytes.len() as u64;
            return Ok(Progress::TooMuch);
        }
        stream.body.extend_from_slice(bytes);
        Ok(progress)
    }

    /// The stream has ended. Returns what it carried.
    //= SM2-GWM-011
    pub(super) fn finish(&mut self, id: StreamId) -> Result<(Header, Bytes), PeerViolation> {
        let stream = self
            .remove(id)
            .ok_or(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"))?;
        let header = stream
            .header
            .ok_or(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"))?;
        if stream.body.len() as u64 != header.len {
            return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"));
        }
        Ok((header, stream.body.into()))
    }

    /// Discards the bytes of a stream.
    pub(super) fn forget(&mut self, id: StreamId) {
        self.remove(id);
    }

    /// The offer that a stream belongs to, once its header is complete.
    pub(super) fn offer(&self, id: StreamId) -> Option<Whose> {
        let header = self.streams.get(&id)?.header?;
        Some(match header.kind {
            HeaderKind::Message { .. } | HeaderKind::Reply { .. } => Whose::Theirs(header.offer),
            HeaderKind::Request { .. } => Whose::Ours(header.offer),
        })
    }

    pub(super) fn len(&self) -> usize {
        self.streams.len()
    }

    /// The bytes that have arrived of payloads that are not complete.
    pub(super) const fn held_bytes(&self) -> u64 {
        self.held_bytes
    }

    /// The stream that has been silent for the longest time, and since when.
    pub(super) fn longest_silent(&self) -> Option<(StreamId, Instant)> {
        let moved = self.streams.iter().map(|(id, it)| (*id, it.moved));
        moved.min_by_key(|(_, moved)| *moved)
    }

    fn remove(&mut self, id: StreamId) -> Option<Stream> {
        let stream = self.streams.remove(&id)?;
        self.held_bytes -= stream.body.len() as u64;
        Some(stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use quinn_proto::{Dir, Side};
    use sm2_proto::gateway::OfferId;

    const LIMITS: Limits = Limits {
        message_bytes: 100,
        memory_bytes: 150,
        gateway_bytes: 150,
    };

    fn id(number: u64) -> StreamId {
        StreamId::new(Side::Client, Dir::Uni, number)
    }

    fn stream(len: u64, payload: usize) -> Vec<u8> {
        let header = Header {
            kind: HeaderKind::Message {
                sequence: 1,
                age_ns: 0,
            },
            offer: OfferId(3),
            len,
        };
        [&header.to_bytes()[..], &vec![7; payload]].concat()
    }

    //= SM2-GWM-011 test
    #[test]
    fn a_payload_has_the_length_that_its_header_says() {
        for (len, payload, is_legal) in [(0, 0, true), (5, 5, true), (5, 4, false)] {
            let bytes = stream(len, payload);
            for piece in [1, 7, bytes.len()] {
                let mut incoming = Incoming::default();
                for piece in bytes.chunks(piece) {
                    let pushed = incoming.push(id(0), piece, Instant(0), &LIMITS);
                    assert!(pushed.is_ok());
                }
                let end = incoming.finish(id(0));
                assert_eq!(end.is_ok(), is_legal, "{len}, {payload}");
                assert_eq!(incoming.held_bytes, 0);
            }
        }
        let mut incoming = Incoming::default();
        let more = incoming.push(id(0), &stream(5, 6), Instant(0), &LIMITS);
        assert_eq!(
            more,
            Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"))
        );
        assert_eq!(
            incoming.finish(id(9)),
            Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"))
        );
        let mut incoming = Incoming::default();
        let head = &stream(5, 5)[..HEADER_LEN - 1];
        assert_eq!(
            incoming.push(id(0), head, Instant(0), &LIMITS),
            Ok(Progress::More)
        );
        assert_eq!(
            incoming.finish(id(0)),
            Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-011"))
        );
    }

    #[test]
    fn no_more_is_kept_than_the_limits_say() {
        let mut incoming = Incoming::default();
        let long = incoming.push(id(0), &stream(101, 1), Instant(0), &LIMITS);
        assert_eq!(long, Ok(Progress::TooMuch));
        incoming.forget(id(0));
        for number in 1..=2 {
            let pushed = incoming.push(id(number), &stream(100, 70), Instant(number), &LIMITS);
            assert!(matches!(pushed, Ok(Progress::Header(_))));
        }
        let third = incoming.push(id(3), &stream(100, 70), Instant(3), &LIMITS);
        assert_eq!(third, Ok(Progress::TooMuch));
        incoming.forget(id(3));
        assert_eq!(incoming.held_bytes, 140);
        assert_eq!(incoming.longest_silent(), Some((id(1), Instant(1))));
        let more = incoming.push(id(2), &[7; 11], Instant(9), &LIMITS);
        assert_eq!(more, Ok(Progress::TooMuch));
    }
}
