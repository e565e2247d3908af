//! The status of a hub, for reports.

use sm2_proto::{
    Name,
    gateway::{Action, Direction, GatewayId, Rules, Subject},
};

use super::{Hub, NoRoom, Peer};
use crate::{
    peer::ConnectionId,
    shadow::Seen,
    tally::{Counts, Key, Whose},
};

/// A connected peer.
#[derive(Clone, Debug)]
pub struct PeerStatus {
    /// Its id.
    pub id: GatewayId,
    /// Its name.
    pub name: Name,
    /// The connection.
    pub connection: ConnectionId,
    /// The epoch of its process.
    pub epoch: u64,
    /// The topics and services that it offers.
    pub offers: Vec<Subject>,
    /// The topics and services that this gateway offers to it.
    pub offered: Vec<Subject>,
    /// The topics and services that the rules deny it.
    pub denied: Vec<Denial>,
    /// The counts that only the hub can know: [`lost`](Counts::lost),
    /// [`skipped`](Counts::skipped) and, of messages of the domain, [`refused`](Counts::refused).
    pub counts: Counts,
    /// The same counts by topic and service.
    pub counts_by_name: Vec<(Key, Counts)>,
}

/// A topic or service that the rules deny a peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Denial {
    /// The topic or service, of the domain or offered by the peer.
    pub subject: Subject,
    /// The direction that is denied.
    pub direction: Direction,
    /// The index of the rule that denies it; `None` if no rule matches, which denies as well.
    pub rule: Option<usize>,
}

impl Hub {
    /// The status of each connected peer.
    #[must_use]
    pub fn peers(&self) -> Vec<PeerStatus> {
        let status = |(id, it): (&GatewayId, &Peer)| PeerStatus {
            id: *id,
            name: it.name.clone(),
            connection: it.connection,
            epoch: it.epoch,
            offers: it
                .offers
                .values()
                .map(|(subject, _)| subject.clone())
                .collect(),
            offered: it.offered.values().cloned().collect(),
            denied: self.denied(*id, it),
            counts: it.tally.total(),
            counts_by_name: it
                .tally
                .names()
                .map(|(key, counts)| (key.clone(), counts))
                .collect(),
        };
        self.peers.iter().map(status).collect()
    }

    /// The topics and services of the domain that peers want and that the gateway has no room for.
    pub fn waiting(&self) -> impl Iterator<Item = &Subject> {
        self.shares.waiting()
    }

    /// The rules in force.
    #[must_use]
    pub const fn rules(&self) -> &Rules {
        &self.policy.rules
    }

    /// The subjects of the domain and of the peers, whether or not the rules allow them.
    #[must_use]
    pub fn seen(&self) -> Seen {
        let key = |it: &Subject| (it.kind(), it.name().clone());
        let offers = self.peers.iter().map(|(id, it)| {
            let offers = it.offers.values().map(|(subject, _)| key(subject));
            (*id, offers.collect())
        });
        Seen {
            local: self.router.local().map(key).collect(),
            offers: offers.collect(),
        }
    }

    /// The subjects of the domain that the rules do not offer to a peer, and the offers of the peer
    /// that they do not take.
    fn denied(&self, id: GatewayId, peer: &Peer) -> Vec<Denial> {
        let denial = |subject: &Subject, direction| {
            let (kind, name) = (subject.kind(), subject.name());
            let decision = self.policy.rules.decide(kind, name, direction, &id);
            (decision.action == Action::Deny).then(|| Denial {
                subject: subject.clone(),
                direction,
                rule: decision.rule,
            })
        };
        let local = self.router.local();
        let out = local.filter_map(|it| denial(it, Direction::Out));
        let offers = peer.offers.values();
        let into = offers.filter_map(|(it, _)| denial(it, Direction::In));
        out.chain(into).collect()
    }

    /// Counts a message that a queue had no room for, or that could not be published.
    pub(super) fn no_room(&mut self, what: &NoRoom) {
        let (peer, offer) = match what {
            NoRoom::ForPeer { connection, offer } => {
                let peer = self.connections.get(connection);
                (peer.copied(), Whose::Ours(*offer))
            }
            NoRoom::ForDomain { subject, origin } => {
                let route = self.routes.get(&(subject.clone(), *origin));
                let Some(&(peer, offer)) = route else { return };
                (Some(peer), Whose::Theirs(offer))
            }
        };
        if let Some(it) = peer.and_then(|it| self.peers.get_mut(&it)) {
            it.tally.count(offer, |it| it.lost += 1);
        }
    }
}
