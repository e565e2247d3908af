//! An oracle of SPEC sections 4.3, 4.4 and 5: plain lists, without regard for speed.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Code, Contract, EntityId, InterfaceId, LinkId, Name, NodeId, Refusal, TypeId,
    control::{Item, Limits, ToManager, ToNode, UnlinkedReason},
};

pub(crate) use super::matching::LinkQos;
use super::{
    bench::{EPOCH, Event},
    matching::qos,
};

/// An interface anywhere in the domain.
pub(crate) type End = (NodeId, InterfaceId);

#[derive(Clone, Debug)]
struct KnownNode {
    uid: u32,
    name: Option<Name>,
}

#[derive(Clone, Debug)]
pub(crate) struct Oracle {
    sessions: BTreeMap<NodeId, KnownNode>,
    interfaces: BTreeMap<End, Contract>,
    links: BTreeMap<LinkId, [End; 2]>,
    /// Matching pairs that are not linked, because a node ended their link or because there were no
    /// descriptors for it.
    unlinked: BTreeMap<[End; 2], UnlinkedReason>,
    /// All refusals whose interface was not granted later.
    refused: BTreeMap<End, (Contract, Refusal)>,
    /// The number of links that were made.
    made: u64,
    /// Links that no node was told of.
    unheard: BTreeSet<LinkId>,
    /// The number of LINKs that a session may be sent ahead of its reading.
    links_in_flight: usize,
}

impl Oracle {
    pub(crate) fn new(links_in_flight: usize) -> Self {
        Self {
            sessions: BTreeMap::new(),
            interfaces: BTreeMap::new(),
            links: BTreeMap::new(),
            unlinked: BTreeMap::new(),
            refused: BTreeMap::new(),
            made: 0,
            unheard: BTreeSet::new(),
            links_in_flight,
        }
    }

    pub(crate) fn connected(&mut self, node: NodeId, uid: u32) {
        self.sessions.insert(node, KnownNode { uid, name: None });
    }

    pub(crate) fn gone(&mut self, node: NodeId) {
        self.sessions.remove(&node);
        self.interfaces.retain(|&(it, _), _| it != node);
        self.refused.retain(|&(it, _), _| it != node);
    }

    pub(crate) fn link_failed(&mut self, link: LinkId) {
        self.unlinked
            .insert(self.links[&link], UnlinkedReason::Descriptors);
    }

    /// Checks the Manager's outputs for a legal frame of a node.
    //= SM2-LNK-006 test
    pub(crate) fn handled(&mut self, node: NodeId, frame: ToManager, events: &[Event]) {
        // One answer, and only the frames of the links that the input affects.
        let ends = self.links.values().flatten();
        let links = ends.filter(|&&(it, _)| it == node).count();
        let declares = matches!(frame, ToManager::Declare { .. });
        let most = 1 + if declares {
            self.links_in_flight
        } else {
            links
        };
        assert!(events.len() <= most, "{} outputs", events.len());
        match frame {
            ToManager::Hello { name, .. } => self.hello(node, name, events),
            ToManager::Declare {
                interface,
                contract,
            } => self.declare((node, interface), contract, events),
            ToManager::Withdraw { interface } => {
                self.interfaces.remove(&(node, interface));
            }
            ToManager::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked((node, interface), link, code),
            ToManager::Query { .. } => {}
            ToManager::Goodbye { .. } => self.gone(node),
            other => panic!("nobody sends {other:?} here"),
        }
    }

    /// The outputs of deferred work.
    pub(crate) fn ticked(&mut self, events: &[Event]) {
        assert!(events.len() <= self.links_in_flight, "{events:?}");
        for event in events {
            self.linked(event);
        }
    }

    /// Both sides of a link that was made are told of it, once, as long as both exist.
    //= SM2-LNK-006 test
    fn linked(&mut self, event: &Event) {
        let Event::Linked(link, ends) = event else {
            panic!("{event:?} is no link");
        };
        assert!(self.unheard.remove(link), "{link} is told once");
        let ends = ends.each_ref().map(|(node, frame)| match frame {
            ToNode::Link { interface, .. } => (*node, *interface),
            other => panic!("{other:?} is no LINK"),
        });
        assert_eq!(self.links[link], pair(ends[0], ends[1]));
        assert!(ends.iter().all(|end| self.interfaces.contains_key(end)));
    }

    /// The first of the two farewells states the reason.
    fn unlinked(&mut self, end: End, link: LinkId, code: Code) {
        let pair = self.links[&link];
        let ended = self.unlinked.contains_key(&pair);
        let there = pair.iter().all(|end| self.interfaces.contains_key(end));
        if !ended && there && pair.contains(&end) {
            self.unlinked.insert(pair, UnlinkedReason::Ended { code });
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
            let [Event::Sent(_, ToNode::DeclareRefused { reason, .. })] = events else {
                panic!("{events:?}");
            };
            self.refused.insert(end, (contract, reason.clone()));
            return;
        }
        let other = |it: &Contract| it.kind() != contract.kind() || it.name() != contract.name();
        self.refused
            .retain(|&(node, _), (it, _)| node != end.0 || other(it));
        let matching = self.interfaces.iter();
        let matching = matching.filter(|(_, it)| qos(it, &contract).is_some());
        let matching: BTreeSet<End> = matching.map(|(&end, _)| end).collect();
        let (answer, links) = events.split_first().expect("DECLARE is answered");
        let declared = ToNode::Declared {
            interface: end.1,
            matches: u32::try_from(links.len()).expect("few matches"),
        };
        assert_eq!(answer, &Event::Sent(end.0, declared));
        self.interfaces.insert(end, contract);
        for other in matching {
            self.made += 1;
            let link = LinkId {
                epoch: EPOCH,
                serial: self.made,
            };
            self.links.insert(link, pair(end, other));
            self.unheard.insert(link);
        }
        for event in links {
            self.linked(event);
        }
    }

    /// The pairs that are to be linked, and their QoS.
    pub(crate) fn pairs(&self) -> BTreeMap<[End; 2], LinkQos> {
        let mut pairs = BTreeMap::new();
        for (&one, ours) in &self.interfaces {
            for (&other, theirs) in self.interfaces.range(one..).skip(1) {
                let Some(mut qos) = qos(ours, theirs) else {
                    continue;
                };
                qos.sealed |= self.sessions[&one.0].uid != self.sessions[&other.0].uid;
                if !self.unlinked.contains_key(&[one, other]) {
                    pairs.insert([one, other], qos);
                }
            }
        }
        pairs
    }

    /// All items that QUERY can show, without the process ids, in the order of the keys.
    //= SM2-WCH-004 test
    pub(crate) fn listing(&self, limits: Limits) -> Vec<Item> {
        let mut items = vec![Item::Domain {
            limits: limits.into(),
        }];
        for (&node, session) in &self.sessions {
            items.extend(session.name.clone().map(|name| Item::Node {
                node,
                name,
                uid: session.uid,
                pid: 0,
                resuming: false,
                max_links: None,
            }));
            let refused = self.refused.range((node, InterfaceId(0))..);
            let refused: Vec<_> = refused.filter(|((it, _), _)| *it == node).collect();
            let oldest = refused.len().saturating_sub(16);
            for &(&end, (contract, reason)) in &refused[oldest..] {
                items.push(Item::Refusal {
                    entity: entity(end),
                    contract: contract.clone(),
                    reason: reason.clone(),
                });
            }
        }
        for (&end, contract) in &self.interfaces {
            let (entity, contract) = (entity(end), contract.clone());
            items.push(Item::Interface { entity, contract });
        }
        let pairs = self.pairs();
        for (&link, pair) in &self.links {
            if let Some(qos) = pairs.get(pair) {
                let [offering, demanding] = self.sides(pair);
                items.push(Item::Link {
                    link,
                    offering,
                    demanding,
                    version: 1,
                    reliable: qos.reliable,
                    sealed: qos.sealed,
                });
            }
        }
        for (pair, &reason) in &self.unlinked {
            if pair.iter().all(|end| self.interfaces.contains_key(end)) {
                let [offering, demanding] = self.sides(pair);
                items.push(Item::Unlinked {
                    offering,
                    demanding,
                    reason,
                });
            }
        }
        items.sort_by_key(Item::key);
        items
    }

    /// A pair, the publisher or server first.
    fn sides(&self, &[one, other]: &[End; 2]) -> [EntityId; 2] {
        let offers = matches!(
            self.interfaces[&one],
            Contract::Publisher { .. } | Contract::Server { .. }
        );
        let ends = if offers { [one, other] } else { [other, one] };
        ends.map(entity)
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

fn entity((node, interface): End) -> EntityId {
    EntityId { node, interface }
}

pub(crate) fn pair(one: End, other: End) -> [End; 2] {
    [one.min(other), one.max(other)]
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
