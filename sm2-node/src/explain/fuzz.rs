//! The body of the fuzz target `domain_mirror`.

use sm2_proto::{
    EntityId,
    control::{Item, Key},
    domain::Domain,
};

use super::{NEAR_MAX, nearest, sessions, users, why};

/// Asks every query of the tools about each entity that the items name.
pub(crate) fn query_all(domain: &Domain) {
    let entities: Vec<EntityId> = domain.items().flat_map(entities).take(12).collect();
    for &one in &entities {
        let near = nearest(domain, one);
        assert!(near.len() <= NEAR_MAX);
        for near in near {
            assert!(!format!("{near:?}").is_empty());
        }
        for &other in &entities {
            let verdict = why(domain, one, other).with_schemas(|_| Some("plain:u8".into()));
            assert!(!format!("{verdict}").is_empty());
        }
    }
    usage(domain);
}

fn usage(domain: &Domain) {
    let users = users(domain);
    let total: usize = users.values().map(|user| user.sessions as usize).sum();
    assert_eq!(total, domain.nodes().count());
    assert_eq!(sessions(domain).len(), total);
}

fn entities(item: &Item) -> Vec<EntityId> {
    match item.key() {
        Key::Domain => Vec::new(),
        Key::Member { entity } | Key::Claim { entity, .. } => [entity].into(),
        Key::Link { offering, .. } => [offering].into(),
        Key::Unlinked {
            offering,
            demanding,
        } => [offering, demanding].into(),
    }
}
