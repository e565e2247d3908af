//! The used part of the quotas of a domain.

use sm2_node::explain::{SessionUsage, UserUsage, sessions, users};
use sm2_proto::{
    LinkId, NodeId, Refusal,
    control::{Item, Limit, Limits, UnlinkedReason},
};

use super::contracts::scan;
use super::items::{LIDAR, LINK, PLANNER, at, domain, interface, link, refusal, sub};

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
        Item::Domain {
            limits: limits.into(),
        },
        link(false, false),
        interface(at(LIDAR, 2), &sub()),
        loopback,
        claim,
        refused,
        unlinked,
    ];
    let domain = domain(&scan(), &sub(), &more);
    assert_eq!(domain.limits(), Some(&limits.into()));
    let usage = |interfaces, links, refusals, unlinked| SessionUsage {
        interfaces,
        links,
        refusals,
        unlinked,
    };
    let sessions = sessions(&domain);
    assert_eq!(sessions[&NodeId(LIDAR)], usage(2, 3, 0, 1));
    assert_eq!(sessions[&NodeId(PLANNER)], usage(1, 2, 1, 0));
    let user = UserUsage {
        sessions: 2,
        interfaces: 3,
    };
    assert_eq!(
        users(&domain).into_iter().collect::<Vec<_>>(),
        [(1_000, user)]
    );
}
