//! What comes on streams, and without them.

use std::time::Duration;

use bytes::Bytes;
use quinn_proto::{Dir, ReadError, ReadableError, StreamId, VarInt};
use sm2_proto::{
    Code,
    gateway::{
        Carried, Header, OfferId, PeerFarewell, PeerViolation, StreamEnd, StreamToken,
        session::Input,
    },
};

use super::{Event, Peer, PeerCall, code_of, incoming::Progress, token, unreachable_call};
use crate::{
    clock::Now,
    tally::{Counts, Whose},
};

/// What a read takes at a time.
const PIECE_BYTES: usize = 64 << 10;

impl Peer {
    /// The peer has opened streams: each is readable from now on.
    pub(super) fn accept(&mut self, now: Now, dir: Dir) {
        while let Some(id) = self.connection.streams().accept(dir) {
            if dir == Dir::Bi && self.control.is_none() && !self.is_dialled() {
                self.control = Some(id);
            }
            self.read(now, id);
        }
    }

    /// Reads all that is there.
    pub(super) fn read(&mut self, now: Now, id: StreamId) {
        while !self.is_over {
            let mut stream = self.connection.recv_stream(id);
            let mut chunks = match stream.read(true) {
                Ok(chunks) => chunks,
                Err(ReadableError::ClosedStream | ReadableError::IllegalOrderedRead) => return,
            };
            let next = chunks.next(PIECE_BYTES);
            // The windows are told by the next datagram.
            let _ = chunks.finalize();
            match next {
                Ok(Some(chunk)) => self.bytes(now, id, &chunk.bytes),
                Ok(None) => return self.ended(now, id),
                Err(ReadError::Blocked) => return,
                Err(ReadError::Reset(_)) => return self.was_reset(now, id),
            }
        }
    }

    pub(super) fn bytes(&mut self, now: Now, id: StreamId, bytes: &[u8]) {
        if self.control == Some(id) {
            self.session_takes(now, Input::Control(bytes));
            return self.drain_session(now);
        }
        match self.incoming.push(id, bytes, now.at, &self.limits) {
            Ok(Progress::More) => {}
            Ok(Progress::Header(header)) => self.header(now, id, header),
            Ok(Progress::TooMuch) => self.refuse(now, id, PeerFarewell::Resources.code()),
            Err(violation) => self.violated(now, violation),
        }
    }

    pub(super) fn header(&mut self, now: Now, id: StreamId, header: Header) {
        let is_bidirectional = id.dir() == Dir::Bi;
        let is_ours = id.initiator() == self.connection.side();
        let fits = match header.carried {
            Carried::Message { .. } => !is_bidirectional,
            Carried::Request { .. } => is_bidirectional && !is_ours,
            Carried::Reply { .. } => is_bidirectional && is_ours,
        };
        if !fits {
            return self.violated(now, PeerViolation::Malformed);
        }
        if let Carried::Request { .. } = header.carried {
            self.calls.came(id, header.offer);
        }
        let stream = token(id);
        self.session_takes(now, Input::Stream { stream, header });
        self.drain_session(now);
    }

    /// A stream has ended as it should.
    pub(super) fn ended(&mut self, now: Now, id: StreamId) {
        if self.control == Some(id) {
            //= SM2-GWF-001
            self.session_takes(now, Input::Closed(None));
            return self.drain_session(now);
        }
        match self.incoming.finish(id) {
            Ok((header, payload)) => self.carried(id, &header, payload),
            Err(violation) => self.violated(now, violation),
        }
    }

    pub(super) fn carried(&mut self, id: StreamId, header: &Header, payload: Bytes) {
        let offer = header.offer;
        let received = |it: &mut Counts| it.received += 1;
        let event = match header.carried {
            Carried::Message { sequence, age_ns } => {
                self.tally.count(Whose::Theirs(offer), received);
                Event::Message {
                    offer,
                    sequence,
                    age: Duration::from_nanos(age_ns),
                    payload,
                }
            }
            Carried::Request { left_ns } => {
                self.tally.count(Whose::Ours(offer), received);
                Event::Request {
                    call: PeerCall(token(id)),
                    offer,
                    left: (left_ns > 0).then(|| Duration::from_nanos(left_ns)),
                    payload,
                }
            }
            Carried::Reply { status } => {
                let Some(call) = self.calls.is_over(id) else {
                    return;
                };
                self.tally.count(Whose::Theirs(offer), received);
                Event::Reply {
                    call,
                    outcome: status,
                    payload,
                }
            }
        };
        self.events.push_back(event);
    }

    /// The peer has reset a stream: it is no message, and no reply.
    pub(super) fn was_reset(&mut self, now: Now, id: StreamId) {
        if self.control == Some(id) {
            return self.ended(now, id);
        }
        self.incoming.forget(id);
        self.calls.settled(id);
        self.end_sending(id, code_of(StreamEnd::Cancelled.code()));
        self.unanswered(now, id);
    }

    /// The peer does not want what this side sends on a stream.
    pub(super) fn stopped(&mut self, now: Now, id: StreamId, code: VarInt) {
        if self.control == Some(id) {
            return self.ended(now, id);
        }
        self.end_sending(id, code);
        if self.calls.settled(id).is_some() {
            //= SM2-GWS-003
            self.events.push_back(Event::Cancelled {
                call: PeerCall(token(id)),
            });
        }
    }

    /// Small messages that came without a stream.
    //= SM2-GWM-003
    pub(super) fn datagrams(&mut self, now: Now) {
        while let Some(bytes) = self.connection.datagrams().recv() {
            let Some((head, _)) = bytes.split_first_chunk() else {
                return self.violated(now, PeerViolation::Malformed);
            };
            let payload = bytes.slice(head.len()..);
            match Header::from_bytes(head) {
                Ok(header)
                    if header.len == payload.len() as u64
                        && matches!(header.carried, Carried::Message { .. }) =>
                {
                    // No stream has this number.
                    let stream = StreamToken(u64::MAX);
                    self.session_takes(now, Input::Stream { stream, header });
                    self.drain_session_for(now, Some((header, payload)));
                }
                Ok(_) => return self.violated(now, PeerViolation::Malformed),
                Err(violation) => return self.violated(now, violation),
            }
        }
    }

    /// Stops a stream; the peer is told why.
    pub(super) fn refuse(&mut self, now: Now, id: StreamId, code: Code) {
        // Before its header came nobody knows what it is of.
        let offer = self.incoming.offer(id).unwrap_or(Whose::Theirs(OfferId(0)));
        self.tally.count(offer, |it| it.refused += 1);
        self.stop(id, code);
        self.calls.settled(id);
        self.end_sending(id, code_of(code));
        self.unanswered(now, id);
    }

    pub(super) fn stop(&mut self, id: StreamId, code: Code) {
        self.incoming.forget(id);
        // One that is closed already needs none.
        let _ = self.connection.recv_stream(id).stop(code_of(code));
    }

    /// Nothing more is sent on a stream. One that never ends would count as open for ever.
    pub(super) fn end_sending(&mut self, id: StreamId, code: VarInt) {
        let is_ours = id.initiator() == self.connection.side();
        if id.dir() == Dir::Bi || is_ours {
            self.calls.stop_writing(id, &mut self.tally);
            // One that is closed already needs none.
            let _ = self.connection.send_stream(id).reset(code);
        }
    }

    /// If it is a call of this side: it gets no reply.
    pub(super) fn unanswered(&mut self, now: Now, id: StreamId) {
        if let Some(call) = self.calls.is_over(id) {
            self.session_takes(now, Input::Forget { stream: token(id) });
            self.events.push_back(unreachable_call(call));
        }
    }
}
