//! Items of a domain, consistent ones and others.
#![allow(dead_code, reason = "each test uses a part")]

use proptest::prelude::*;
use sm2_proto::{
    Code, Contract, EntityId, InterfaceId, LinkId, NodeId, Refusal,
    control::{Item, Limits, UnlinkedReason},
    domain::Domain,
};

use super::contracts::{client, data, name, publisher_with, server, subscriber, subscriber_with};

pub(crate) const LIDAR: u64 = 1;
pub(crate) const PLANNER: u64 = 2;

pub(crate) const LINK: LinkId = LinkId {
    epoch: 5,
    serial: 1,
};

pub(crate) fn at(node: u64, interface: u64) -> EntityId {
    EntityId {
        node: NodeId(node),
        interface: InterfaceId(interface),
    }
}

pub(crate) fn node(node: u64, text: &str, uid: u32, resuming: bool) -> Item {
    Item::Node {
        node: NodeId(node),
        name: name(text),
        uid,
        pid: 7,
        resuming,
        max_links: None,
    }
}

pub(crate) fn interface(entity: EntityId, contract: &Contract) -> Item {
    let contract = contract.clone();
    Item::Interface { entity, contract }
}

pub(crate) fn refusal(entity: EntityId, contract: &Contract, reason: &Refusal) -> Item {
    Item::Refusal {
        entity,
        contract: contract.clone(),
        reason: reason.clone(),
    }
}

pub(crate) fn link(reliable: bool, sealed: bool) -> Item {
    Item::Link {
        link: LINK,
        offering: at(LIDAR, 1),
        demanding: at(PLANNER, 1),
        version: 1,
        reliable,
        sealed,
    }
}

/// lidar with the one interface and planner with the other, and further items.
pub(crate) fn domain(one: &Contract, other: &Contract, more: &[Item]) -> Domain {
    let mut domain = Domain::new();
    domain.page([
        node(LIDAR, "lidar", 1_000, false),
        interface(at(LIDAR, 1), one),
        node(PLANNER, "planner", 1_000, false),
        interface(at(PLANNER, 1), other),
    ]);
    domain.page(more.iter().cloned());
    domain
}

pub(crate) fn sub() -> Contract {
    subscriber("scan", Some(&data("Scan")))
}

fn contracts() -> impl Strategy<Value = Contract> {
    let topic = prop_oneof![
        Just("scan"),
        Just("Scan"),
        Just("front/scan"),
        Just("image")
    ];
    let kind = prop_oneof![Just("A"), Just("B")];
    (0..4_u8, topic, kind, any::<[bool; 3]>()).prop_map(|(contract, topic, kind, flags)| {
        let data = data(kind);
        let [reliable, sealed, stated] = flags;
        match contract {
            0 => publisher_with(topic, &data, reliable, sealed),
            1 => subscriber_with(topic, stated.then_some(&data), reliable, sealed),
            2 => server(topic, &data, &data),
            _ => client(topic, stated.then_some((&data, &data))),
        }
    })
}

pub(crate) fn entities() -> impl Strategy<Value = EntityId> + Clone {
    (1..4_u64, 0..4_u64).prop_map(|(node, interface)| at(node, interface))
}

/// Any items that a Manager may send, consistent or not.
pub(crate) fn items() -> impl Strategy<Value = Item> {
    let refusals = prop_oneof![
        Just(Refusal::NameTaken),
        Just(Refusal::TopicType { theirs: data("A") }),
        Just(Refusal::Denied { rule: None }),
    ];
    let reasons = prop_oneof![
        Just(UnlinkedReason::Descriptors),
        any::<u16>().prop_map(|code| UnlinkedReason::Ended { code: Code(code) }),
        (1..5_u64).prop_map(|number| UnlinkedReason::Quota {
            node: NodeId(number),
            limit: 3
        }),
    ];
    let pairs = || (entities(), entities());
    prop_oneof![
        1 => Just(Item::Domain {
            limits: Limits::default().into()
        }),
        2 => (1..4_u64, any::<bool>())
            .prop_map(|(number, resuming)| node(number, "lidar", 1_000, resuming)),
        6 => (entities(), contracts()).prop_map(|(entity, contract)| interface(entity, &contract)),
        1 => (entities(), contracts(), refusals)
            .prop_map(|(entity, contract, reason)| refusal(entity, &contract, &reason)),
        1 => (pairs(), any::<[bool; 2]>()).prop_map(|((offering, demanding), [reliable, sealed])| {
            Item::Link {
                link: LINK,
                offering,
                demanding,
                version: 1,
                reliable,
                sealed,
            }
        }),
        1 => entities().prop_map(|entity| Item::Claim { link: LINK, entity }),
        1 => (pairs(), reasons).prop_map(|((offering, demanding), reason)| Item::Unlinked {
            offering,
            demanding,
            reason
        }),
    ]
}
