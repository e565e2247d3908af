//! The nodes, interfaces and links of a domain, and the used part of its quotas.

use crate::support::{
    contracts::{scan, subscriber},
    items::{LIDAR, LINK, PLANNER, at, domain, interface, link, refusal, sub},
};
use sm2_proto::{
    LinkId, NodeId, Refusal,
    control::{Item, Limit, Limits, UnlinkedReason},
    domain::{SessionUsage, UserUsage},
};

#[test]
fn names_lead_to_interfaces() {
    let domain = domain(
        &scan(),
        &sub(),
        &[interface(at(PLANNER, 2), &subscriber("lidar", None))],
    );
    let found = |text| domain.find(text);
    assert_eq!(found("planner:scan"), [at(PLANNER, 1)]);
    assert_eq!(found("/planner:/scan"), [at(PLANNER, 1)]);
    assert_eq!(found("/scan"), [at(LIDAR, 1), at(PLANNER, 1)]);
    assert_eq!(found("lidar"), [at(PLANNER, 2)], "a topic before a node");
    assert_eq!(found("planner"), [at(PLANNER, 1), at(PLANNER, 2)]);
    for nothing in ["image", "arm:scan", "planner:image", ""] {
        assert_eq!(found(nothing), []);
    }
    assert_eq!(
        domain.node_named("planner").map(|it| it.node),
        Some(NodeId(PLANNER))
    );
    assert_eq!(domain.interfaces_of(NodeId(PLANNER)).count(), 2);
}

//= SM2-RES-008 test
#[test]
fn what_is_used_up() {
    let limits = Limits::default().with(Limit::LinksPerSession, 3);
    let loopback = Item::Link {
        link: LinkId { serial: 2, ..LINK },
        offering: at(LIDAR, 1),
        demanding: at(LIDAR, 2),
        version: 1,
        reliable: false,
        sealed: false,
    };
    let claim = Item::Claim {
        link: LinkId { serial: 3, ..LINK },
        entity: at(PLANNER, 1),
    };
    let refused = refusal(at(PLANNER, 2), &sub(), &Refusal::NameTaken);
    let unlinked = Item::Unlinked {
        offering: at(LIDAR, 1),
        demanding: at(PLANNER, 3),
        reason: UnlinkedReason::Descriptors,
    };
    let more = [
        Item::Domain { limits },
        link(false, false),
        interface(at(LIDAR, 2), &sub()),
        loopback,
        claim,
        refused,
        unlinked,
    ];
    let domain = domain(&scan(), &sub(), &more);
    assert_eq!(domain.limits(), Some(&limits));
    let usage = |interfaces, links, refusals, unlinked| SessionUsage {
        interfaces,
        links,
        refusals,
        unlinked,
    };
    let sessions = domain.sessions();
    assert_eq!(sessions[&NodeId(LIDAR)], usage(2, 3, 0, 1));
    assert_eq!(sessions[&NodeId(PLANNER)], usage(1, 2, 1, 0));
    let user = UserUsage {
        sessions: 2,
        interfaces: 3,
    };
    assert_eq!(
        domain.users().into_iter().collect::<Vec<_>>(),
        [(1_000, user)]
    );
}
