//! Reading from streams and datagrams.

use std::time::Duration;

use bytes::Bytes;
use quinn_proto::{Dir, ReadError, ReadableError, StreamId, VarInt};
use sm2_proto::{
    Code,
    gateway::{
        Header, HeaderKind, OfferId, PeerFarewell, PeerViolationKind, StreamEnd,
        session::{self, Initiator, Input, PeerEvent, Transport},
    },
    violation,
};

use super::{
    Event, Limits, Message, Peer, PeerCall,
    incoming::Progress,
    stream::{quic_code, token},
};
use crate::{
    clock::Now,
    tally::{Counts, Whose},
};

/// The greatest length of one read.
const PIECE_BYTES: usize = 64 << 10;

const fn received(counts: &mut Counts) {
    counts.received += 1;
}

impl Peer {
    /// The peer has opened streams.
    pub(super) fn accept(&mut self, now: Now, dir: Dir) {
        while let Some(id) = self.connection.streams().accept(dir) {
            if dir == Dir::Bi
                && self.initiator() == Initiator::Peer
                && let Some(open) = self.phase.open_mut()
            {
                open.control.get_or_insert(id);
            }
            self.read(now, id);
        }
    }

    /// Reads what has arrived on a stream.
    pub(super) fn read(&mut self, now: Now, id: StreamId) {
        while !self.phase.is_over() {
            let mut stream = self.connection.recv_stream(id);
            let mut chunks = match stream.read(true) {
                Ok(chunks) => chunks,
                Err(ReadableError::ClosedStream | ReadableError::IllegalOrderedRead) => return,
            };
            let next = chunks.next(PIECE_BYTES);
            // The next datagram carries the new flow control windows.
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
        if self.phase.is_control(id) {
            self.session_event(now, PeerEvent::Control(bytes));
            return;
        }
        let memory_bytes = self.memory_bytes().saturating_sub(self.sending_bytes());
        let limits = Limits {
            memory_bytes,
            ..self.limits
        };
        match self.incoming.push(id, bytes, now.at, &limits) {
            Ok(Progress::More) => {}
            Ok(Progress::Header(header)) => self.header(now, id, header),
            Ok(Progress::TooMuch) => self.refuse(now, id, PeerFarewell::Resources.code()),
            Err(violation) => self.violated(now, violation),
        }
    }

    pub(super) fn header(&mut self, now: Now, id: StreamId, header: Header) {
        let is_bidirectional = id.dir() == Dir::Bi;
        let is_ours = id.initiator() == self.connection.side();
        let fits = match header.kind {
            HeaderKind::Message { .. } => !is_bidirectional,
            HeaderKind::Request { .. } => is_bidirectional && !is_ours,
            HeaderKind::Reply { .. } => is_bidirectional && is_ours,
        };
        if !fits {
            let violation = violation!(PeerViolationKind::Malformed, "SM2-GWM-002");
            return self.violated(now, violation);
        }
        if let HeaderKind::Request { .. } = header.kind {
            self.calls.add_theirs(id, header.offer);
        }
        let transport = Transport::Stream(token(id));
        self.session_event(now, PeerEvent::Header { transport, header });
    }

    /// A stream has ended regularly.
    pub(super) fn ended(&mut self, now: Now, id: StreamId) {
        if self.phase.is_control(id) {
            //= SM2-GWF-001
            self.session_event(now, PeerEvent::Closed(None));
            return;
        }
        match self.incoming.finish(id) {
            Ok((header, payload)) => self.payload_complete(now, id, &header, payload),
            Err(violation) => self.violated(now, violation),
        }
    }

    /// The payload of a stream has arrived completely.
    pub(super) fn payload_complete(
        &mut self,
        now: Now,
        id: StreamId,
        header: &Header,
        payload: Bytes,
    ) {
        let offer = header.offer;
        let event = match header.kind {
            HeaderKind::Message { sequence, age_ns } => {
                return self.message(now, offer, sequence, age_ns, payload);
            }
            HeaderKind::Request { left_ns } => {
                self.tally.count(Whose::Ours(offer), received);
                Event::Request {
                    call: PeerCall(token(id)),
                    offer,
                    deadline: (left_ns > 0).then(|| now.at.after(Duration::from_nanos(left_ns))),
                    payload,
                }
            }
            HeaderKind::Reply { status } => {
                let Some(call) = self.calls.remove_ours(id) else {
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

    /// The session takes the message of a datagram.
    pub(super) fn datagram(&mut self, now: Now, header: &Header, payload: Bytes) {
        if let HeaderKind::Message { sequence, age_ns } = header.kind {
            self.message(now, header.offer, sequence, age_ns, payload);
        }
    }

    fn message(&mut self, now: Now, offer: OfferId, sequence: u64, age_ns: u64, payload: Bytes) {
        self.tally.count(Whose::Theirs(offer), received);
        let age = Duration::from_nanos(age_ns);
        let message = Message::arrived(now.at, sequence, age, payload);
        self.events.push_back(Event::Message { offer, message });
    }

    /// The peer has reset a stream, so its message, request or reply never arrives.
    pub(super) fn was_reset(&mut self, now: Now, id: StreamId) {
        if self.phase.is_control(id) {
            return self.ended(now, id);
        }
        self.incoming.forget(id);
        self.calls.remove_theirs(id);
        self.end_sending(id, quic_code(StreamEnd::Cancelled.code()));
        self.unanswered(now, id);
    }

    /// The peer has stopped a stream of this side.
    pub(super) fn stopped(&mut self, now: Now, id: StreamId, code: VarInt) {
        if self.phase.is_control(id) {
            return self.ended(now, id);
        }
        self.end_sending(id, code);
        if self.calls.remove_theirs(id).is_some() {
            //= SM2-GWS-003
            self.events.push_back(Event::Cancelled {
                call: PeerCall(token(id)),
            });
        }
    }

    /// Takes messages that arrived as datagrams.
    //= SM2-GWM-003
    pub(super) fn datagrams(&mut self, now: Now) {
        while let Some(bytes) = self.connection.datagrams().recv() {
            let Some((head, _)) = bytes.split_first_chunk() else {
                return self.violated(now, violation!(PeerViolationKind::Malformed, "SM2-GWM-003"));
            };
            let payload = bytes.slice(head.len()..);
            match Header::from_bytes(head) {
                Ok(header) if header.len == payload.len() as u64 => {
                    let transport = Transport::Datagram;
                    let event = PeerEvent::Header { transport, header };
                    self.feed_session(now, Input::Event(event), Some((header, payload)));
                }
                Ok(_) => {
                    let violation = violation!(PeerViolationKind::Malformed, "SM2-GWM-003");
                    return self.violated(now, violation);
                }
                Err(violation) => return self.violated(now, violation),
            }
        }
    }

    /// Refuses the payload of a stream with this code.
    pub(super) fn refuse(&mut self, now: Now, id: StreamId, code: Code) {
        // The offer is unknown until the header is complete.
        let offer = self.incoming.offer(id).unwrap_or(Whose::Theirs(OfferId(0)));
        self.tally.count(offer, |it| it.refused += 1);
        self.stop(id, code);
        self.calls.remove_theirs(id);
        self.end_sending(id, quic_code(code));
        self.unanswered(now, id);
    }

    pub(super) fn stop(&mut self, id: StreamId, code: Code) {
        self.incoming.forget(id);
        // Fails only for a stream that is closed already.
        let _ = self.connection.recv_stream(id).stop(quic_code(code));
    }

    /// Resets the sending direction of a stream. A stream that never ends would count as open for ever.
    pub(super) fn end_sending(&mut self, id: StreamId, code: VarInt) {
        let is_ours = id.initiator() == self.connection.side();
        if id.dir() == Dir::Bi || is_ours {
            self.calls.stop_writing(id, &mut self.tally);
            // Fails only for a stream that is closed already.
            let _ = self.connection.send_stream(id).reset(code);
            self.unacked.remove(id);
        }
    }

    /// A stream carries no reply any more. If it is a call of this side, the call is unreachable.
    pub(super) fn unanswered(&mut self, now: Now, id: StreamId) {
        if let Some(call) = self.calls.remove_ours(id) {
            let stream = token(id);
            self.session_command(now, session::Command::Forget { stream });
            self.events.push_back(Event::unreachable(call));
        }
    }
}
