//! The tables of peers whose connections have ended. A peer with thousands of offers has some hundred thousand
//! names, whose memory is given back in pieces.

use std::collections::VecDeque;

use sm2_proto::Instant;

use super::peer::Peer;

/// How many entries of the tables are freed in one piece.
const PIECE_ENTRIES: usize = 512;

/// The peers whose connections have ended, and whose tables are not freed yet.
#[derive(Debug, Default)]
pub(super) struct EndedPeers {
    peers: VecDeque<Peer>,
    /// The time since when there are some.
    since: Option<Instant>,
}

impl EndedPeers {
    /// Adds a peer, and frees the first piece.
    pub(super) fn add(&mut self, now: Instant, peer: Peer) {
        self.peers.push_back(peer);
        self.since.get_or_insert(now);
        self.free();
    }

    /// The time since when there is something to free.
    pub(super) const fn since(&self) -> Option<Instant> {
        self.since
    }

    /// Frees the next piece.
    pub(super) fn free(&mut self) {
        let mut left = PIECE_ENTRIES;
        while let Some(peer) = self.peers.front_mut() {
            while peer.free_entry() {
                left -= 1;
                if left == 0 {
                    return;
                }
            }
            self.peers.pop_front();
        }
        self.since = None;
    }
}

impl Peer {
    /// Frees one entry of the tables. False if none is left.
    fn free_entry(&mut self) -> bool {
        self.offers.pop_first().is_some()
            || self.offered.pop_first().is_some()
            || self.tally.free_entry()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use sm2_proto::{
        Name, TypeId,
        gateway::{OfferId, Subject, session::Initiator},
    };

    use super::*;
    use crate::{
        peer::ConnectionId,
        tally::{Tally, Whose},
    };

    #[test]
    fn the_tables_of_a_peer_are_freed_in_bounded_pieces() {
        let name = Name::new("peer").unwrap();
        let mut peer = Peer {
            connection: ConnectionId(1),
            initiator: Initiator::Peer,
            epoch: 1,
            name: name.clone(),
            offers: BTreeMap::new(),
            offered: BTreeMap::new(),
            tally: Tally::default(),
        };
        // Three entries for each offer.
        let offers = 1_000;
        for number in 1..=offers {
            let subject = Subject::Topic {
                name: Name::new(&format!("topic{number}")).unwrap(),
                data: TypeId {
                    name: name.clone(),
                    hash: 0,
                },
                reliable: false,
                latched: 0,
            };
            peer.tally.open(Whose::Ours(OfferId(number)), &subject);
            peer.offered.insert(OfferId(number), subject);
        }
        let mut ended = EndedPeers::default();
        ended.add(Instant(7), peer);
        let mut pieces = 1;
        while ended.since() == Some(Instant(7)) {
            ended.free();
            pieces += 1;
        }
        assert_eq!(pieces, 3 * offers as usize / PIECE_ENTRIES + 1);
        assert_eq!(ended.since(), None);
    }
}
