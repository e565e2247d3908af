//! The calls of a connection that are not over.

use std::collections::BTreeMap;

use quinn_proto::StreamId;
use sm2_proto::gateway::OfferId;

use super::{
    ahead::Room,
    id::CallId,
    outgoing::{Outgoing, Written},
    outlet::Outlet,
};
use crate::tally::{Tally, Whose};

/// The calls of a connection that are not over, in both directions.
#[derive(Debug, Default)]
pub(super) struct OpenCalls {
    /// The calls of this side, by stream.
    ours: BTreeMap<StreamId, CallId>,
    /// The offers that the calls of the peer are for, by stream, until the reply.
    theirs: BTreeMap<StreamId, OfferId>,
    /// Requests and replies that are not written completely, and their offers.
    writing: Vec<(Whose, Outgoing)>,
}

impl OpenCalls {
    pub(super) fn len(&self) -> usize {
        self.ours.len() + self.theirs.len() + self.writing.len()
    }

    /// Adds a call of this side.
    pub(super) fn add_ours(&mut self, id: StreamId, call: CallId) {
        self.ours.insert(id, call);
    }

    /// Adds a call of the peer.
    pub(super) fn add_theirs(&mut self, id: StreamId, offer: OfferId) {
        self.theirs.insert(id, offer);
    }

    /// Removes a call of this side, which has its reply or will have none.
    pub(super) fn remove_ours(&mut self, id: StreamId) -> Option<CallId> {
        self.ours.remove(&id)
    }

    /// Removes a call of the peer, which needs no further reply. Returns its offer.
    pub(super) fn remove_theirs(&mut self, id: StreamId) -> Option<OfferId> {
        self.theirs.remove(&id)
    }

    /// The stream of a call of this side.
    pub(super) fn stream(&self, call: CallId) -> Option<StreamId> {
        let found = self.ours.iter().find(|(_, it)| **it == call);
        found.map(|(id, _)| *id)
    }

    /// The sum of the lengths of requests and replies that are not written completely.
    pub(super) fn writing_bytes(&self) -> u64 {
        let lens = self.writing.iter().map(|(_, it)| it.len_bytes() as u64);
        lens.sum()
    }

    /// The requests that are not written completely: their offers and streams.
    pub(super) fn requests_in_flight(&self) -> impl Iterator<Item = (Whose, StreamId)> {
        let requests = (self.writing.iter()).filter(|(of, _)| matches!(of, Whose::Theirs(_)));
        requests.map(|(offer, it)| (*offer, it.stream))
    }

    /// Queues a request or a reply.
    pub(super) fn send(&mut self, offer: Whose, outgoing: Outgoing) {
        self.writing.push((offer, outgoing));
    }

    /// Stops writing to a stream that is being reset.
    pub(super) fn stop_writing(&mut self, id: StreamId, tally: &mut Tally) {
        self.writing.retain(|(offer, it)| {
            let stays = it.stream != id;
            if !stays {
                tally.count(*offer, |it| it.withdrawn += 1);
            }
            stays
        });
    }

    /// The connection is over. Returns the calls of this side without a reply.
    pub(super) fn end(&mut self, tally: &mut Tally) -> impl Iterator<Item = CallId> + use<> {
        for (offer, _) in self.writing.drain(..) {
            tally.count(offer, |it| it.withdrawn += 1);
        }
        self.theirs.clear();
        std::mem::take(&mut self.ours).into_values()
    }

    /// True if there is nothing to write.
    pub(super) const fn is_idle(&self) -> bool {
        self.writing.is_empty()
    }

    /// Writes requests and replies as far as there is `room`.
    pub(super) fn write(&mut self, outlet: &mut Outlet<'_>, room: &mut Room) {
        self.writing.retain_mut(|(offer, outgoing)| {
            match outgoing.write(outlet.connection, room) {
                Written::Part | Written::NoRoom => return true,
                Written::All => {
                    outlet.tally.count(*offer, |it| it.sent += 1);
                    outlet.unacked.add(outgoing.stream, outgoing.len_bytes());
                }
                Written::Stopped => outlet.tally.count(*offer, |it| it.withdrawn += 1),
            }
            false
        });
    }
}
