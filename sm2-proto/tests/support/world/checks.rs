//! The checks of the world.

use std::collections::BTreeMap;

use sm2_proto::{LinkId, NodeId, manager::Manager};

use super::{World, limits};
use crate::support::oracle::{End, LinkQos, pair};

impl World {
    /// Pages and changes show exactly the oracle's items.
    pub(super) fn check_listing(&mut self) {
        assert_eq!(self.manager.sessions(), self.oracle.sessions());
        if let Some(session) = self.oracle.a_ready_session() {
            let expected = self.oracle.listing(limits(self.links_in_flight));
            self.onlooker.check(&self.manager, session, &expected);
        }
    }

    /// When nothing is in flight, both sides of each link know of it with the same QoS, and each
    /// pair that is to be linked has a link.
    pub(super) fn check_links(&self) {
        let mut known: BTreeMap<[End; 2], Vec<(LinkId, LinkQos)>> = BTreeMap::new();
        for process in self.processes.iter().flatten() {
            for (&(interface, link), &(other, qos)) in &process.links {
                let ends = pair((process.session, interface), other);
                known.entry(ends).or_default().push((link, qos));
            }
        }
        for (ends, sides) in &known {
            assert!(
                matches!(sides[..], [one, other] if one == other),
                "{ends:?}: {sides:?}"
            );
        }
        let known: BTreeMap<_, _> = known.iter().map(|(ends, it)| (*ends, it[0].1)).collect();
        assert_eq!(known, self.oracle.pairs());
        assert_eq!(self.manager.links(), known.len());
    }

    /// No session is sent more LINKs than the limits allows before it has read all of them. One
    /// more is allowed if a link joins two interfaces of the session.
    //= SM2-LNK-006 test
    pub(super) fn check_pace(&self, session: NodeId) {
        let waiting = self.sockets[&session].to_node.iter();
        let links = waiting.filter(|(_, fds)| !fds.is_empty()).count();
        assert!(
            links <= self.links_in_flight + 1,
            "{links} LINKs for {session}"
        );
    }

    /// No state is kept of sessions that are gone. The machine's own invariants, which are checked
    /// after each input, cover the rest.
    pub(crate) fn end(mut self) -> (Manager, Vec<(NodeId, Vec<u8>)>) {
        self.run_until_quiet();
        let last = (self.manager.clone(), std::mem::take(&mut self.trace));
        for slot in 0..self.processes.len() {
            self.crash(slot);
        }
        self.run_until_quiet();
        assert_eq!((self.manager.sessions(), self.manager.links()), (0, 0));
        assert!(self.sockets.is_empty());
        last
    }
}
