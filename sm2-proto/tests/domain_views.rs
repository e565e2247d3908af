//! The nodes, interfaces and links of a domain.

use crate::support::{
    contracts::{scan, subscriber},
    items::{LIDAR, PLANNER, at, domain, interface, sub},
};
use sm2_proto::NodeId;

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
