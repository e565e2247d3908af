//! Interfaces and who is linked with whom (SPEC sections 4.3, 4.4 and 5).

use alloc::{sync::Arc, vec::Vec};

use super::{
    Manager, Output,
    links::End,
    policy::within,
    session::{Farewells, Session},
};
use crate::{
    Code, Contract, Farewell, InterfaceId, LinkId, NodeId, Quota, Refusal, VERSION, Violation,
    control::{Peer, ToNode, encode_to_node},
    limits::LINKS_MAX,
    match_contracts,
};

impl Manager {
    pub(super) fn declare(&mut self, end: End, contract: Contract) -> Result<(), Violation> {
        let Some(session) = self.sessions.get_mut(&end.node) else {
            return Ok(());
        };
        session.number(end.interface)?;
        match self.admit(end.node, &contract) {
            Ok(matches) => self.admitted(end, contract, &matches),
            Err(reason) => {
                let interface = end.interface;
                self.send(end.node, &ToNode::DeclareRefused { interface, reason });
            }
        }
        Ok(())
    }

    /// Whether an interface can be granted, and whom it is to be linked with.
    //= SM2-IFC-005, SM2-IFC-006
    fn admit(&self, id: NodeId, contract: &Contract) -> Result<Vec<End>, Refusal> {
        let Some(session) = self.sessions.get(&id) else {
            return Ok(Vec::new());
        };
        session.refuse_interface(&self.policy)?;
        self.users
            .refuse_interface(session.credentials().uid, &self.policy)?;
        let Some(channel) = self.channels.get(contract) else {
            return Ok(Vec::new());
        };
        channel.refuse_types(contract)?;
        self.admit_links(id, channel.matches(contract))
    }

    /// The matches that the quotas of links leave, out of some in ascending order.
    //= SM2-MAT-002
    fn admit_links(
        &self,
        id: NodeId,
        matches: impl Iterator<Item = End>,
    ) -> Result<Vec<End>, Refusal> {
        let limit = self.policy.links_per_session.min(LINKS_MAX);
        let used = |node: NodeId| self.sessions.get(&node).map_or(0, Session::link_ends);
        let mut ours = used(id);
        // A session's interfaces stand together, so one other count is enough.
        let mut theirs = (id, 0);
        let mut admitted = Vec::new();
        for other in matches {
            if other.node == id {
                // Both ends of the link are ours.
                ours += 1;
            } else {
                if other.node != theirs.0 {
                    theirs = (other.node, used(other.node));
                }
                if theirs.1 >= limit {
                    continue;
                }
                theirs.1 += 1;
            }
            ours += 1;
            within(limit, ours, Quota::LinksPerSession)?;
            admitted.push(other);
        }
        Ok(admitted)
    }

    //= SM2-IFC-002
    fn admitted(&mut self, end: End, contract: Contract, matches: &[End]) {
        let Some(session) = self.sessions.get_mut(&end.node) else {
            return;
        };
        self.users.declare(session.credentials().uid);
        let contract = Arc::new(contract);
        self.channels.insert(end, &contract);
        session.declare(end.interface, contract);
        self.revision += 1;
        self.send(
            end.node,
            &ToNode::Declared {
                interface: end.interface,
                matches: u32::try_from(matches.len()).unwrap_or(u32::MAX),
            },
        );
        for &other in matches {
            self.link(end, other);
        }
    }

    //= SM2-LNK-001, SM2-MAT-002, SM2-MAT-003, SM2-VER-002
    fn link(&mut self, one: End, other: End) {
        let (Some((uid, ours)), Some((their_uid, theirs))) = (self.peer(one), self.peer(other))
        else {
            return;
        };
        let Ok(terms) = match_contracts(&ours.contract, &theirs.contract) else {
            return;
        };
        let sealed = terms.sealed || self.policy.seals(uid == their_uid);
        let link = self.links.insert([one, other]);
        for end in [one, other] {
            if let Some(session) = self.sessions.get_mut(&end.node) {
                session.link(end.interface, link);
            }
        }
        let frame = |interface: InterfaceId, peer: Peer| {
            encode_to_node(&ToNode::Link {
                interface,
                link,
                version: VERSION,
                reliable: terms.reliable,
                sealed,
                peer,
            })
        };
        let ends = [
            (one.node, frame(one.interface, theirs)),
            (other.node, frame(other.interface, ours)),
        ];
        self.outputs.push_back(Output::Link { link, ends });
    }

    /// An interface as the other side of a link gets to know it, and whose it is.
    fn peer(&self, End { node, interface }: End) -> Option<(u32, Peer)> {
        let session = self.sessions.get(&node)?;
        let peer = Peer {
            node,
            name: session.name()?.clone(),
            interface,
            contract: session.contract(interface)?.clone(),
        };
        Some((session.credentials().uid, peer))
    }

    /// A link was never made: neither end is to be told of it.
    //= SM2-IFC-002
    pub(super) fn link_failed(&mut self, link: LinkId) {
        let Some(ends) = self.links.remove(link) else {
            return;
        };
        for end in ends {
            if let Some(session) = self.sessions.get_mut(&end.node) {
                session.unlink(end.interface, link);
            }
        }
        self.revision += 1;
    }

    //= SM2-IFC-003
    pub(super) fn withdraw(&mut self, end: End) -> Result<(), Violation> {
        let session = self.sessions.get_mut(&end.node);
        let (uid, (contract, links)) = session
            .and_then(|it| Some((it.credentials().uid, it.withdraw(end.interface)?)))
            .ok_or(Violation::UnknownInterface)?;
        self.users.withdraw(uid, 1);
        self.channels.remove(end, &contract);
        for link in links {
            self.end_link(link, end, Farewell::Done.code());
        }
        self.revision += 1;
        let interface = end.interface;
        self.send(end.node, &ToNode::Withdrawn { interface });
        Ok(())
    }

    /// A node's farewell to its end of a link.
    //= SM2-LNK-003, SM2-LNK-004
    pub(super) fn unlinked(&mut self, end: End, link: LinkId, code: Code) -> Result<(), Violation> {
        let interface = end.interface;
        let session = self.sessions.get_mut(&end.node);
        let session = session.ok_or(Violation::UnknownInterface)?;
        match session.farewell(interface, link)? {
            Farewells::Both => {}
            Farewells::First => {
                self.send(
                    end.node,
                    &ToNode::Unlink {
                        interface,
                        link,
                        code,
                    },
                );
                self.end_link(link, end, code);
                self.revision += 1;
            }
        }
        Ok(())
    }

    /// One end of a link is gone: the other one is told, if the link was live.
    pub(super) fn end_link(&mut self, link: LinkId, gone: End, code: Code) {
        let ends = self.links.remove(link).into_iter().flatten();
        for End { node, interface } in ends.filter(|&end| end != gone) {
            if let Some(session) = self.sessions.get_mut(&node) {
                session.tell(interface, link);
                self.send(
                    node,
                    &ToNode::Unlink {
                        interface,
                        link,
                        code,
                    },
                );
            }
        }
    }
}
