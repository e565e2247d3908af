//! How a hub is, for reports.

use sm2_proto::gateway::{Action, Direction, GatewayId, Rules, Subject};

use super::{Denial, Hub, NoRoom, Peer, PeerStatus};
use crate::{shadow::Seen, tally::Whose};

impl Hub {
    /// Who is connected, and what goes to and fro.
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

    /// The rules that hold now.
    #[must_use]
    pub const fn rules(&self) -> &Rules {
        &self.policy.rules
    }

    /// What is there, whatever the rules say of it.
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

    /// What the rules keep from a peer of what the domain has, and what they do not take of what it
    /// offers.
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

    /// A message is lost here.
    pub(super) fn no_room(&mut self, what: &NoRoom) {
        let (peer, offer) = match what {
            NoRoom::ForPeer { connection, offer } => {
                let peer = self.connections.get(connection);
                (peer.copied(), Whose::Ours(*offer))
            }
            NoRoom::ForDomain { subject, origin } => {
                let route = self.calls.routes.get(&(subject.clone(), *origin));
                let Some(&(peer, offer)) = route else { return };
                (Some(peer), Whose::Theirs(offer))
            }
        };
        if let Some(it) = peer.and_then(|it| self.peers.get_mut(&it)) {
            it.tally.count(offer, |it| it.lost += 1);
        }
    }
}
