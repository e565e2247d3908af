//! Harnesses for topics and services: an interface is added or removed, from any state of two
//! interfaces.

use alloc::sync::Arc;

use super::{Channels, Contract, EntityId, Kind, Name, TypeId};
use crate::{
    DemandedQos, InterfaceId, NodeId, OfferedQos, Refusal, ServiceQos,
    proofs::{below, one_of},
};

fn name(text: &str) -> Name {
    Name::new(text).expect("a legal name")
}

/// A type that differs in its hash only.
fn data(hash: u64) -> TypeId {
    let name = name("t");
    TypeId { name, hash }
}

/// An interface on "a" or on "b", with a type or, if its kind allows that, without one.
fn contract(kind: Kind, on: &str, hash: Option<u64>) -> Contract {
    let qos = ServiceQos {
        depth: 1,
        max_borrowed: 1,
        sealed: false,
    };
    match kind {
        Kind::Publisher => Contract::Publisher {
            topic: name(on),
            data: data(hash.unwrap_or(1)),
            offer: OfferedQos::new(1),
        },
        Kind::Subscriber => Contract::Subscriber {
            topic: name(on),
            data: hash.map(data),
            demand: DemandedQos::new(1, 1),
        },
        Kind::Server => Contract::Server {
            service: name(on),
            request: data(1),
            reply: data(hash.unwrap_or(1)),
            qos,
        },
        Kind::Client => Contract::Client {
            service: name(on),
            types: hash.map(|hash| (data(1), data(hash))),
            qos,
        },
    }
}

const KINDS: [Kind; 4] = [
    Kind::Publisher,
    Kind::Subscriber,
    Kind::Server,
    Kind::Client,
];

fn any_contract(on: &str, hashes: &[u64]) -> Contract {
    let kind = one_of(&KINDS);
    let states = matches!(kind, Kind::Publisher | Kind::Server) || kani::any();
    contract(kind, on, if states { Some(one_of(hashes)) } else { None })
}

const fn entity(node: u64) -> EntityId {
    let (node, interface) = (NodeId(node), InterfaceId(1));
    EntityId { node, interface }
}

/// A topic or service has one type as long as any interface states one. A topic and a service of
/// one name do not affect each other. Matches are the counterparts, in ascending order.
//= SM2-NAM-002, SM2-IFC-005, SM2-MAT-001 kani
// Shows MGR-TYPES (Exhaustive), bound: one interface more and one less, from any 2 on one name.
#[cfg_attr(kani, kani::proof)]
// Three interfaces; names of one byte.
#[cfg_attr(kani, kani::unwind(5))]
fn a_channel_has_one_type() {
    let mut channels = Channels::new();
    let mut there = alloc::vec::Vec::new();
    for node in 0..below(3) as u64 {
        // All interfaces that state a type state the same one.
        let contract = Arc::new(any_contract("a", &[1]));
        channels.insert(entity(node), &contract);
        there.push((entity(node), contract));
    }
    assert!(channels.are_tight());
    let on = one_of(&["a", "b"]);
    let new = Arc::new(any_contract(on, &[1, 2]));
    let is_topic = |it: &Contract| matches!(it.kind(), Kind::Publisher | Kind::Subscriber);
    let beside = |it: &Contract| on == "a" && is_topic(it) == is_topic(&new);
    let typed = there
        .iter()
        .any(|(_, it)| beside(it) && it.types().is_some());
    let other = *new == contract(new.kind(), on, Some(2)) && new.types().is_some();
    let verdict = channels
        .get(&new)
        .map_or(Ok(()), |it| it.refuse_types(&new));
    let expected = match (typed && other, is_topic(&new)) {
        (false, _) => Ok(()),
        (true, true) => Err(Refusal::TopicType { theirs: data(1) }),
        (true, false) => Err(Refusal::ServiceType {
            request: data(1),
            reply: data(1),
        }),
    };
    assert_eq!(verdict, expected);
    kani::cover!(expected.is_err() && there.len() == 2, "another type");
    kani::cover!(
        !typed && other && !there.is_empty() && on == "a",
        "the first type"
    );
    if expected.is_ok() {
        let counterpart = new.kind().counterpart();
        let matches = there
            .iter()
            .filter(|(_, it)| beside(it) && it.kind() == counterpart);
        let found = channels
            .get(&new)
            .into_iter()
            .flat_map(|it| it.matches(&new));
        assert!(matches.map(|(entity, _)| *entity).eq(found));
        channels.insert(entity(9), &new);
        there.push((entity(9), new));
    }
    assert_eq!(channels.ends(), there.len());
    assert!(channels.are_tight());
    if !there.is_empty() {
        let (entity, gone) = there.remove(below(there.len()));
        channels.remove(entity, &gone);
        channels.remove(entity, &gone);
    }
    assert_eq!(channels.ends(), there.len());
    assert!(
        channels.are_tight(),
        "it has a type as long as one states it"
    );
}

#[cfg(test)]
kani::explored! {
    a_channel_has_one_type: 2,
}
