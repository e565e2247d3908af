//! Calls, both ways.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::{Connection, Dir, StreamId};
use sm2_proto::{
    Instant,
    gateway::{Carried, Header, Outcome, StreamEnd, session::Input},
};

use super::{
    Peer,
    ahead::Room,
    code_of,
    outgoing::{Outgoing, Written},
    stream_id, unreachable_call,
};
use crate::{
    clock::Now,
    tally::{Tally, Whose},
};

/// The calls of a connection that are not over.
#[derive(Debug, Default)]
pub(super) struct Calls {
    /// Those of this side, by their streams: the caller's names for them.
    tickets: BTreeMap<StreamId, u64>,
    /// Those of the peer's that wait for a reply: the offers that they were for.
    came: BTreeMap<StreamId, u64>,
    /// Requests and replies that are not written whole, and the offers that they are of.
    writing: Vec<(Whose, Outgoing)>,
}

impl Calls {
    pub(super) fn len(&self) -> usize {
        self.tickets.len() + self.came.len() + self.writing.len()
    }

    /// A call of the peer's is to be replied to.
    pub(super) fn came(&mut self, id: StreamId, offer: u64) {
        self.came.insert(id, offer);
    }

    /// No reply to it is due any more; if one was: the offer that it was for.
    pub(super) fn settled(&mut self, id: StreamId) -> Option<u64> {
        self.came.remove(&id)
    }

    /// A call of this side has its reply, or will have none: the caller's name for it.
    pub(super) fn is_over(&mut self, id: StreamId) -> Option<u64> {
        self.tickets.remove(&id)
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
    pub(super) fn end(&mut self, tally: &mut Tally) -> impl Iterator<Item = u64> + use<> {
        for (offer, _) in self.writing.drain(..) {
            tally.count(offer, |it| it.withdrawn += 1);
        }
        self.came.clear();
        std::mem::take(&mut self.tickets).into_values()
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
        ticket: u64,
        offer: u64,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        let Some(id) = self.connection.streams().open(Dir::Bi) else {
            return self.events.push_back(unreachable_call(ticket));
        };
        let stream = id.into();
        if !self.session_takes(now, Input::Call { stream, offer }) {
            self.end_sending(id, code_of(StreamEnd::Cancelled.code()));
            return self.events.push_back(unreachable_call(ticket));
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
        self.calls.tickets.insert(id, ticket);
        self.send_call(id, Whose::Theirs(offer), &header, payload);
    }

    //= SM2-GWS-003
    pub(super) fn forget(&mut self, now: Now, ticket: u64) {
        let found = self.calls.tickets.iter().find(|(_, it)| **it == ticket);
        if let Some((&id, _)) = found {
            self.session_takes(now, Input::Forget { stream: id.into() });
            self.abandon(id);
        }
    }

    /// Whatever comes of a call of this side, nobody reads it. The caller's name for it.
    pub(super) fn abandon(&mut self, id: StreamId) -> Option<u64> {
        let ticket = self.calls.is_over(id)?;
        let code = StreamEnd::Cancelled.code();
        self.stop(id, code);
        self.end_sending(id, code_of(code));
        Some(ticket)
    }

    //= SM2-GWS-002
    pub(super) fn reply(&mut self, call: u64, outcome: Outcome, payload: Bytes) {
        let id = stream_id(call);
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
