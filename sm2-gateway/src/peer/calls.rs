//! Calls in both directions.

use bytes::Bytes;
use quinn_proto::{Dir, StreamId};
use sm2_proto::{
    Instant,
    gateway::{Header, HeaderKind, OfferId, Outcome, StreamEnd, session},
};

use super::{
    CallId, Event, Peer, PeerCall,
    outgoing::Outgoing,
    stream::{quic_code, stream_id, token},
};
use crate::{clock::Now, tally::Whose};

/// The reason of a call whose reply finds no room.
const NO_ROOM: &str =
    "the replies for this peer exceed `memory_bytes`, or its part of `gateway_bytes`";

impl Peer {
    //= SM2-GWS-001
    pub(super) fn call(
        &mut self,
        now: Now,
        call: CallId,
        offer: OfferId,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        if !self.has_room_for(payload.len()) {
            self.tally.count(Whose::Theirs(offer), |it| it.lost += 1);
            return self.events.push_back(Event::unreachable(call));
        }
        let Some(id) = self.connection.streams().open(Dir::Bi) else {
            return self.events.push_back(Event::unreachable(call));
        };
        let stream = token(id);
        if !self.session_command(now, session::Command::Call { stream, offer }) {
            self.end_sending(id, quic_code(StreamEnd::Cancelled.code()));
            return self.events.push_back(Event::unreachable(call));
        }
        let left_ns = deadline.map_or(0, |it| {
            let left_ns = u64::try_from(it.since(now.at).as_nanos()).unwrap_or(u64::MAX);
            // Zero would mean that there is no deadline.
            left_ns.max(1)
        });
        let header = Header {
            kind: HeaderKind::Request { left_ns },
            offer,
            len: payload.len() as u64,
        };
        self.calls.add_ours(id, call);
        self.send_call(id, Whose::Theirs(offer), &header, payload);
    }

    //= SM2-GWS-003
    pub(super) fn forget(&mut self, now: Now, call: CallId) {
        if let Some(id) = self.calls.stream(call) {
            let stream = token(id);
            self.session_command(now, session::Command::Forget { stream });
            self.abandon(id);
        }
    }

    /// Resets both directions of the stream of a call of this side. Returns the hub's number of it.
    pub(super) fn abandon(&mut self, id: StreamId) -> Option<CallId> {
        let call = self.calls.remove_ours(id)?;
        let code = StreamEnd::Cancelled.code();
        self.stop(id, code);
        self.end_sending(id, quic_code(code));
        Some(call)
    }

    //= SM2-GWS-002
    pub(super) fn reply(&mut self, call: PeerCall, outcome: Outcome, payload: Bytes) {
        let id = stream_id(call.0);
        let Some(offer) = self.calls.remove_theirs(id) else {
            return;
        };
        let (outcome, payload) = match outcome.has_payload() {
            true if self.has_room_for(payload.len()) => (outcome, payload),
            true => {
                self.tally.count(Whose::Ours(offer), |it| it.lost += 1);
                (Outcome::Failed, Bytes::from_static(NO_ROOM.as_bytes()))
            }
            false => (outcome, Bytes::new()),
        };
        let header = Header {
            kind: HeaderKind::Reply { status: outcome },
            offer,
            len: payload.len() as u64,
        };
        self.send_call(id, Whose::Ours(offer), &header, payload);
    }

    /// True if a request or a reply of this length fits in the memory budget.
    fn has_room_for(&self, len_bytes: usize) -> bool {
        let used_bytes = self.incoming.held_bytes() + self.sending_bytes();
        used_bytes + len_bytes as u64 <= self.memory_bytes()
    }

    fn send_call(&mut self, id: StreamId, offer: Whose, header: &Header, payload: Bytes) {
        // After control frames, which have priority 2, and before messages, which have 0 or less.
        let _ = self.connection.send_stream(id).set_priority(1);
        self.tally.count(offer, |it| it.offered += 1);
        let outgoing = Outgoing::new(id, header, payload);
        self.calls.send(offer, outgoing);
    }
}
