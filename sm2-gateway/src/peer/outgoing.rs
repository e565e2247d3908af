//! Payloads that are written to streams. QUIC holds on to the written memory, without a copy, until
//! the peer has acknowledged it.

use bytes::{Buf, Bytes};
use quinn_proto::{Connection, StreamId, WriteError};
use sm2_proto::gateway::{Header, StreamEnd};

use super::{ahead::Room, stream::quic_code};

/// A header and a payload that are being written to a stream.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) stream: StreamId,
    /// The length of the payload.
    len_bytes: usize,
    /// The parts of header and payload that are not written yet.
    rest: [Bytes; 2],
}

/// How far a payload was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Written {
    /// Completely, and its stream is finished.
    All,
    /// As far as the peer's flow control allows now.
    Part,
    /// As far as there was room.
    NoRoom,
    /// The peer has stopped the stream.
    Stopped,
}

impl Outgoing {
    pub(super) fn new(stream: StreamId, header: &Header, payload: Bytes) -> Self {
        let head = Bytes::copy_from_slice(&header.to_bytes());
        Self {
            stream,
            len_bytes: payload.len(),
            rest: [head, payload],
        }
    }

    /// The length of the payload.
    pub(super) const fn len_bytes(&self) -> usize {
        self.len_bytes
    }

    /// Writes as far as there is `room`, and reduces it.
    pub(super) fn write(&mut self, connection: &mut Connection, room: &mut Room) -> Written {
        let mut stream = connection.send_stream(self.stream);
        while let Some(next) = self.rest.iter_mut().find(|it| !it.is_empty()) {
            let left = room.left(self.len_bytes);
            if left == 0 {
                return Written::NoRoom;
            }
            let mut piece = next.slice(..next.len().min(left));
            match stream.write_chunks(std::slice::from_mut(&mut piece)) {
                Ok(written) => {
                    next.advance(written.bytes);
                    room.take(written.bytes);
                }
                Err(WriteError::Blocked) => return Written::Part,
                Err(WriteError::Stopped(_) | WriteError::ClosedStream) => return Written::Stopped,
            }
        }
        match stream.finish() {
            Ok(()) => Written::All,
            Err(_) => Written::Stopped,
        }
    }

    /// Resets the stream, so that the peer does not wait for the rest.
    pub(super) fn reset(&self, connection: &mut Connection, end: StreamEnd) {
        // Fails only for a stream that is closed already.
        let _ = connection
            .send_stream(self.stream)
            .reset(quic_code(end.code()));
    }
}
