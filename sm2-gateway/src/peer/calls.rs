//! Calls, both ways.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::{Connection, Dir, StreamId};
use sm2_proto::{
    Instant,
    gateway::{Carried, Header, OfferId, Outcome, StreamEnd, session},
};

use super::{
    CallId, Peer, PeerCall,
    ahead::Room,
    code_of,
    outgoing::{Outgoing, Written},
    stream_id, token, unreachable_call,
};
use crate::{
    clock::Now,
    tally::{Tally, Whose},
};

/// The calls of a connection that are not over.
#[derive(Debug, Default)]
pub(super) struct Calls {
    /// Those of this side, by their streams: the caller's names for them.
    ours: BTreeMap<StreamId, CallId>,
    /// Those of the peer's that wait for a reply: the offers that they were for.
    came: BTreeMap<StreamId, OfferId>,
    /// Requests and replies that are not written whole, and the offers that they are of.
    writing: Vec<(Whose, Outgoing)>,
}

impl Calls {
    pub(super) fn len(&self) -> usize {
        self.ours.len() + self.came.len() + self.writing.len()
    }

    /// A call of the peer's is to be replied to.
    pub(super) fn came(&mut self, id: StreamId, offer: OfferId) {
        self.came.insert(id, offer);
    }

    /// No reply to it is due any more; if one was: the offer that it was for.
    pub(super) fn settled(&mut self, id: StreamId) -> Option<OfferId> {
        self.came.remove(&id)
    }

    /// A call of this side has its reply, or will have none: the caller's name for it.
    pub(super) fn is_over(&mut self, id: StreamId) -> Option<CallId> {
        self.ours.remove(&id)
    }

    /// Its stream is reset.
    pub(super) fn stop_writing(&mut self, id: StreamId, tally: &mut Tally) {
        self.writing.retain(|(offer, it)| {
            let stays = it.stream != id;
            if !stays {
                tally.count(*offer, |it| it.withdrawn += 1);
            }
            stays
        });
    }

    /// The connection is over: the calls without a reply.
    pub(super) fn end(&mut self, tally: &mut Tally) -> impl Iterator<Item = CallId> + use<> {
        for (offer, _) in self.writing.drain(..) {
            tally.count(offer, |it| it.withdrawn += 1);
        }
        self.came.clear();
        std::mem::take(&mut self.ours).into_values()
    }

    /// Whether nothing is to be written.
    pub(super) const fn is_idle(&self) -> bool {
        self.writing.is_empty()
    }

    /// Writes what there is `room` for.
    pub(super) fn write(
        &mut self,
        connection: &mut Connection,
        room: &mut Room,
        tally: &mut Tally,
    ) {
        self.writing.retain_mut(|(offer, outgoing)| {
            match outgoing.write(connection, room) {
                Written::Part | Written::NoRoom => return true,
                Written::All => tally.count(*offer, |it| it.sent += 1),
                Written::Stopped => tally.count(*offer, |it| it.withdrawn += 1),
            }
            false
        });
    }
}

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
        let Some(id) = self.connection.streams().open(Dir::Bi) else {
            return self.events.push_back(unreachable_call(call));
        };
        let stream = token(id);
        if !self.session_command(now, session::Command::Call { stream, offer }) {
            self.end_sending(id, code_of(StreamEnd::Cancelled.code()));
            return self.events.push_back(unreachable_call(call));
        }
        let left = deadline.map_or(0, |it| {
            // Zero would be none.
            u64::try_from(it.since(now.at).as_nanos())
                .unwrap_or(u64::MAX)
                .max(1)
        });
        let header = Header {
            carried: Carried::Request { left_ns: left },
            offer,
            len: payload.len() as u64,
        };
        self.calls.ours.insert(id, call);
        self.send_call(id, Whose::Theirs(offer), &header, payload);
    }

    //= SM2-GWS-003
    pub(super) fn forget(&mut self, now: Now, call: CallId) {
        let found = self.calls.ours.iter().find(|(_, it)| **it == call);
        if let Some((&id, _)) = found {
            let stream = token(id);
            self.session_command(now, session::Command::Forget { stream });
            self.abandon(id);
        }
    }

    /// Whatever comes of a call of this side, nobody reads it. The caller's name for it.
    pub(super) fn abandon(&mut self, id: StreamId) -> Option<CallId> {
        let call = self.calls.is_over(id)?;
        let code = StreamEnd::Cancelled.code();
        self.stop(id, code);
        self.end_sending(id, code_of(code));
        Some(call)
    }

    //= SM2-GWS-002
    pub(super) fn reply(&mut self, call: PeerCall, outcome: Outcome, payload: Bytes) {
        let id = stream_id(call.0);
        let Some(offer) = self.calls.settled(id) else {
            return;
        };
        let payload = match outcome.has_payload() {
            true => payload,
            false => Bytes::new(),
        };
        let header = Header {
            carried: Carried::Reply { status: outcome },
            offer,
            len: payload.len() as u64,
        };
        self.send_call(id, Whose::Ours(offer), &header, payload);
    }

    fn send_call(&mut self, id: StreamId, offer: Whose, header: &Header, payload: Bytes) {
        // Before messages, after what is said of offers.
        let _ = self.connection.send_stream(id).set_priority(1);
        self.tally.count(offer, |it| it.offered += 1);
        let outgoing = Outgoing::new(id, header, payload);
        self.calls.writing.push((offer, outgoing));
    }
}
