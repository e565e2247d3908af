//! Payloads that come: the header, as many bytes as it says, and the end of the stream.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::StreamId;
use sm2_proto::{
    Instant,
    gateway::{HEADER_LEN, Header, PeerViolation},
};

use super::Limits;

/// Streams whose payload is not whole yet.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    streams: BTreeMap<StreamId, Stream>,
    /// The bytes of all of them.
    held_bytes: u64,
}

#[derive(Debug)]
struct Stream {
    head: Vec<u8>,
    header: Option<Header>,
    body: Vec<u8>,
    /// When something came last.
    moved: Instant,
}

/// What follows from bytes that came.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// Nothing yet.
    More,
    /// The header is there: whether its payload is to be read is another's to say.
    Header(Header),
    /// It is longer, or there is more of it at a time, than this side takes.
    TooMuch,
}

impl Incoming {
    /// Takes bytes of a stream.
    //= SM2-GWM-006
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
            return Err(PeerViolation::Malformed);
        }
        self.held_bytes += bytes.len() as u64;
        if header.len > limits.message_bytes || self.held_bytes > limits.memory_bytes {
            self.held_bytes -= bytes.len() as u64;
            return Ok(Progress::TooMuch);
        }
        stream.body.extend_from_slice(bytes);
        Ok(progress)
    }

    /// The stream has ended: what it carried.
    //= SM2-GWM-006
    pub(super) fn finish(&mut self, id: StreamId) -> Result<(Header, Bytes), PeerViolation> {
        let stream = self.remove(id).ok_or(PeerViolation::Malformed)?;
        let header = stream.header.ok_or(PeerViolation::Malformed)?;
        if stream.body.len() as u64 != header.len {
            return Err(PeerViolation::Malformed);
        }
        Ok((header, stream.body.into()))
    }

    /// Nothing more of it is wanted.
    pub(super) fn forget(&mut self, id: StreamId) {
        self.remove(id);
    }

    pub(super) fn len(&self) -> usize {
        self.streams.len()
    }

    /// The stream that nothing came on for the longest time, and since when.
    pub(super) fn slowest(&self) -> Option<(StreamId, Instant)> {
        let moved = self.streams.iter().map(|(id, it)| (*id, it.moved));
        moved.min_by_key(|(_, moved)| *moved)
    }

    fn remove(&mut self, id: StreamId) -> Option<Stream> {
        let stream = self.streams.remove(&id)?;
        self.held_bytes -= stream.body.len() as u64;
        Some(stream)
    }
}
