//! Payloads that go: each is written as far as QUIC takes it, and its memory is QUIC's from then
//! on, without a copy, until it has arrived.

use bytes::{Buf, Bytes};
use quinn_proto::{Connection, StreamId, WriteError};
use sm2_proto::gateway::{Header, StreamEnd};

use super::{ahead::Room, code_of};

/// A header and a payload on their way into a stream.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) stream: StreamId,
    /// Of the payload.
    len_bytes: usize,
    rest: [Bytes; 2],
}

/// How far one was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Written {
    /// All of it, and the end.
    All,
    /// As much as the other side takes now.
    Part,
    /// As much as there was room for.
    NoRoom,
    /// The other side does not want it.
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

    /// Writes no more than there is `room` for, which it takes.
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

    /// The other side is not to wait for the rest.
    pub(super) fn reset(&self, connection: &mut Connection, end: StreamEnd) {
        // One that is closed already needs none.
        let _ = connection
            .send_stream(self.stream)
            .reset(code_of(end.code()));
    }
}
