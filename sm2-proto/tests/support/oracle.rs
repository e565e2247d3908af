//! What a domain looks like according to SPEC 4.3, 4.4 and 5: lists, and no thought of cost.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Contract, InterfaceId, LinkId, Name, NodeId, TypeId,
    control::{Item, ToManager, ToNode},
};

use super::bench::Event;

/// An interface anywhere in the domain.
pub(crate) type End = (NodeId, InterfaceId);

/// What both sides of a link have to know of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Terms {
    pub(crate) reliable: bool,
    pub(crate) sealed: bool,
}

#[derive(Clone, Debug)]
struct Session {
    uid: u32,
    name: Option<Name>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Oracle {
    sessions: BTreeMap<NodeId, Session>,
    interfaces: BTreeMap<End, Contract>,
    links: BTreeMap<LinkId, [End; 2]>,
    /// Pairs that are not linked although they match: a node ended their link,
    /// or there were no descriptors for it.
    apart: BTreeSet<[End; 2]>,
}

impl Oracle {
    pub(crate) fn connected(&mut self, node: NodeId, uid: u32) {
        self.sessions.insert(node, Session { uid, name: None });
    }

    pub(crate) fn gone(&mut self, node: NodeId) {
        self.sessions.remove(&node);
        self.interfaces.retain(|&(it, _), _| it != node);
    }

    pub(crate) fn link_failed(&mut self, link: LinkId) {
        self.apart.insert(self.links[&link]);
    }

    /// A node's legal frame, and what the Manager made of it.
    pub(crate) fn handled(&mut self, node: NodeId, frame: ToManager, events: &[Event]) {
        match frame {
            ToManager::Hello { name, .. } => self.hello(node, name, events),
            ToManager::Declare {
                interface,
                contract,
            } => self.declare((node, interface), contract, events),
            ToManager::Withdraw { interface } => {
                self.interfaces.remove(&(node, interface));
            }
            ToManager::Unlinked { link, .. } => {
                self.apart.insert(self.links[&link]);
            }
            ToManager::Query { .. } => {}
            ToManager::Goodbye { .. } => self.gone(node),
        }
    }

    fn hello(&mut self, node: NodeId, name: Name, events: &[Event]) {
        let wanted = Some(name);
        let taken = self.sessions.values().any(|it| it.name == wanted);
        let refused = matches!(events, [Event::Sent(_, ToNode::HelloRefused { .. })]);
        assert_eq!(refused, taken, "{events:?}");
        if !taken {
            let session = self.sessions.get_mut(&node).expect("it is connected");
            session.name = wanted;
        }
    }

    fn declare(&mut self, end: End, contract: Contract, events: &[Event]) {
        let refused = matches!(events, [Event::Sent(_, ToNode::DeclareRefused { .. })]);
        let conflict = self.interfaces.values().any(|it| conflict(it, &contract));
        assert_eq!(refused, conflict, "{contract:?} {events:?}");
        if refused {
            return;
        }
        let matching = self.interfaces.iter();
        let matching = matching.filter(|(_, it)| terms(it, &contract).is_some());
        let matching: BTreeSet<End> = matching.map(|(&end, _)| end).collect();
        let (answer, links) = events.split_first().expect("DECLARE is answered");
        let declared = ToNode::Declared {
            interface: end.1,
            matches: u32::try_from(matching.len()).expect("few matches"),
        };
        assert_eq!(answer, &Event::Sent(end.0, declared));
        let mut linked = BTreeSet::new();
        for event in links {
            let Event::Linked(link, [_, (node, ToNode::Link { interface, .. })]) = event else {
                panic!("{event:?} is no link");
            };
            linked.insert((*node, *interface));
            self.links.insert(*link, pair(end, (*node, *interface)));
        }
        assert_eq!(linked, matching);
        assert_eq!(links.len(), matching.len(), "each pair once");
        self.interfaces.insert(end, contract);
    }

    /// The pairs that are to be linked, and how.
    pub(crate) fn pairs(&self) -> BTreeMap<[End; 2], Terms> {
        let mut pairs = BTreeMap::new();
        for (&one, ours) in &self.interfaces {
            for (&other, theirs) in self.interfaces.range(one..).skip(1) {
                let Some(mut terms) = terms(ours, theirs) else {
                    continue;
                };
                terms.sealed |= self.sessions[&one.0].uid != self.sessions[&other.0].uid;
                if !self.apart.contains(&[one, other]) {
                    pairs.insert([one, other], terms);
                }
            }
        }
        pairs
    }

    /// Everything that QUERY can show, without the process ids.
    pub(crate) fn listing(&self) -> Vec<Item> {
        let pairs = self.pairs();
        let mut items = Vec::new();
        for (&node, session) in &self.sessions {
            let Some(name) = session.name.clone() else {
                continue;
            };
            items.push(Item::Node {
                node,
                name,
                uid: session.uid,
                pid: 0,
            });
            let own = self.interfaces.iter().filter(|((it, _), _)| *it == node);
            items.extend(own.map(|(&end, contract)| {
                let links = pairs.keys().flatten().filter(|&&it| it == end);
                Item::Interface {
                    node,
                    interface: end.1,
                    contract: contract.clone(),
                    links: u32::try_from(links.count()).expect("few links"),
                }
            }));
        }
        items
    }

    pub(crate) fn sessions(&self) -> usize {
        self.sessions.len()
    }

    pub(crate) fn a_ready_session(&self) -> Option<NodeId> {
        let mut sessions = self.sessions.iter();
        let (&node, _) = sessions.find(|(_, it)| it.name.is_some())?;
        Some(node)
    }
}

pub(crate) fn pair(one: End, other: End) -> [End; 2] {
    [one.min(other), one.max(other)]
}

/// SM2-MAT-001 and, for the two sides alone, SM2-MAT-003.
fn terms(one: &Contract, other: &Contract) -> Option<Terms> {
    match (one, other) {
        (
            Contract::Publisher { topic, data, offer },
            Contract::Subscriber {
                topic: theirs,
                data: wanted,
                demand,
            },
        ) => {
            let same = topic == theirs && (wanted.is_none() || wanted.as_ref() == Some(data));
            let terms = Terms {
                reliable: demand.reliable,
                sealed: offer.sealed || demand.sealed,
            };
            (same && (offer.reliable || !demand.reliable)).then_some(terms)
        }
        (
            Contract::Server {
                service,
                request,
                reply,
                qos,
            },
            Contract::Client {
                service: theirs,
                types,
                qos: wanted,
            },
        ) => {
            let same_types = match types {
                None => true,
                Some((a, b)) => a == request && b == reply,
            };
            let terms = Terms {
                reliable: true,
                sealed: qos.sealed || wanted.sealed,
            };
            (service == theirs && same_types).then_some(terms)
        }
        (Contract::Subscriber { .. }, Contract::Publisher { .. })
        | (Contract::Client { .. }, Contract::Server { .. }) => terms(other, one),
        _ => None,
    }
}

/// SM2-IFC-005: two interfaces that state different types for one topic or service.
fn conflict(one: &Contract, other: &Contract) -> bool {
    let stated = |contract: &Contract| -> (bool, Name, Option<Vec<TypeId>>) {
        match contract.clone() {
            Contract::Publisher { topic, data, .. } => (true, topic, Some(vec![data])),
            Contract::Subscriber { topic, data, .. } => (true, topic, data.map(|it| vec![it])),
            Contract::Server {
                service,
                request,
                reply,
                ..
            } => (false, service, Some(vec![request, reply])),
            Contract::Client { service, types, .. } => {
                (false, service, types.map(|(a, b)| vec![a, b]))
            }
        }
    };
    match (stated(one), stated(other)) {
        ((is_topic, name, Some(types)), (it_is_too, theirs, Some(their_types))) => {
            is_topic == it_is_too && name == theirs && types != their_types
        }
        _ => false,
    }
}
