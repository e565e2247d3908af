//! Other rules: in force at once, and announced in pieces.
//!
//! 1. Each connection gets the rules, and sends nothing from then on that they deny.
//! 2. The router applies the rules to all sources in pieces, and first to a source that is used in between.
//! 3. The QoS of the offers changes, in pieces.
//! 4. Each connection learns that nothing is left that the rules deny.

use std::{ops::Bound, sync::Arc};

use sm2_proto::{
    Instant, Machine,
    gateway::{Direction, Rules, router},
};

use super::{
    Hub, Output,
    open_calls::{Caller, OpenCall},
    policy::{Policy, Reload},
};
use crate::peer::{Command, ConnectionId};

/// How many offers get their QoS in one piece.
const PIECE_OFFERS: usize = 512;

impl Hub {
    //= SM2-GWR-004
    pub(super) fn reload(&mut self, now: Instant, policy: Policy) {
        self.policy = policy;
        let rules = self.policy.rules.clone();
        self.announce(Some(&Arc::new(rules.clone())));
        let (since, after) = (now, None);
        self.reload = Some(Reload { since, after });
        self.route(now, router::Input::Rules(rules));
        if self.router.deadline().is_none() {
            self.change_qos();
        }
    }

    /// Goes on with what other rules and the begin or end of connections have left.
    pub(super) fn tick(&mut self, now: Instant) {
        match self.router.deadline() {
            Some(_) => self.route(now, router::Input::Tick),
            None if self.reload.is_some() => self.change_qos(),
            None => self.ended_peers.free(),
        }
    }

    /// Changes the QoS of the next offers.
    fn change_qos(&mut self) {
        let Some(Reload { after, .. }) = &mut self.reload else {
            return;
        };
        let mut left = PIECE_OFFERS;
        let from = after.map_or(Bound::Unbounded, |(peer, _)| Bound::Included(peer));
        for (&id, peer) in self.peers.range((from, Bound::Unbounded)) {
            let rest = match *after {
                Some((of, offer)) if of == id => Bound::Excluded(offer),
                _ => Bound::Unbounded,
            };
            for (&offer, subject) in peer.offered.range((rest, Bound::Unbounded)) {
                if left == 0 {
                    return;
                }
                left -= 1;
                *after = Some((id, offer));
                let qos = self.policy.send_qos(subject, &id);
                self.outputs.push_back(Output::Peer {
                    connection: peer.connection,
                    command: Command::Change { offer, qos },
                });
            }
        }
        self.reload = None;
        self.announce(None);
    }

    fn announce(&mut self, rules: Option<&Arc<Rules>>) {
        for peer in self.peers.values() {
            self.outputs.push_back(Output::Peer {
                connection: peer.connection,
                command: Command::Rules(rules.cloned()),
            });
        }
    }

    /// False if other rules deny the service, and the router has not come to it yet.
    //= SM2-GWR-004
    pub(super) fn may_reply(&self, call: &OpenCall) -> bool {
        if self.router.deadline().is_none() {
            return true;
        }
        let (kind, name) = (call.subject.kind(), call.subject.name());
        let allows = |direction, connection: &ConnectionId| {
            let peer = self.connections.get(connection);
            peer.is_none_or(|peer| self.policy.rules.allow(kind, name, direction, peer))
        };
        let may_leave = match &call.caller {
            Caller::Peer { connection, .. } => allows(Direction::Out, connection),
            Caller::Local { .. } => true,
        };
        may_leave && call.sent_by.iter().all(|it| allows(Direction::In, it))
    }
}
