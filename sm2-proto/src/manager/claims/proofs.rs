//! Harnesses for claims: one step from any two claims that wait.

use super::{Agreed, Claim, Claims, EntityId, LinkId, NodeId};
use crate::{
    Instant, LinkKey, LinkQos, VERSION,
    proofs::{below, one_of},
};

const LINKS: [LinkId; 3] = [
    LinkId {
        epoch: 1,
        serial: 1,
    },
    LinkId {
        epoch: 1,
        serial: 2,
    },
    LinkId {
        epoch: 2,
        serial: 1,
    },
];

const fn entity(node: u64) -> EntityId {
    EntityId::node(NodeId(node))
}

fn any_claim() -> (LinkId, Claim) {
    let (reliable, other_version): (bool, bool) = kani::any();
    let qos = LinkQos {
        reliable,
        sealed: false,
    };
    let version = VERSION + u16::from(other_version);
    let agreed = Agreed { version, qos };
    let key = LinkKey(u64::from(kani::any::<bool>()));
    (one_of(&LINKS), Claim { key, agreed })
}

/// MGR-CLAIM: a claim joins the claim with the same link, key, version and QoS, and no other one. A
/// node that does not know the key joins no link.
//= SM2-RES-004 kani
// Shows MGR-CLAIM (Exhaustive), bound: one step from any state of up to 2 claims; 3 links, 2 keys, 2 versions, 2
// terms.
#[cfg_attr(kani, kani::proof)]
// Two claims.
#[cfg_attr(kani, kani::unwind(5))]
fn only_the_same_claims_meet() {
    let mut claims = Claims::new();
    let waiting = [any_claim(), any_claim()];
    // Two equal claims would have met.
    kani::assume(waiting[0] != waiting[1]);
    let there = below(3);
    for (at, (link, claim)) in waiting.into_iter().enumerate().take(there) {
        claims.half.insert((link, entity(at as u64)), claim);
        claims.waiting.insert((link, claim), entity(at as u64));
    }
    assert!(claims.agree());
    let (link, claim) = any_claim();
    let same = waiting[..there].iter().position(|it| *it == (link, claim));
    let met = claims.meet(link, entity(7), claim);
    assert_eq!(met, same.map(|at| entity(at as u64)));
    assert!(claims.agree());
    let left = if same.is_some() { there - 1 } else { there + 1 };
    assert_eq!(claims.iter().count(), left);
    assert_eq!(claims.item(link, entity(7)).is_some(), same.is_none());
    let other_key = |it: &(LinkId, Claim)| it.0 == link && it.1.key != claim.key;
    kani::cover!(
        waiting[..there].iter().any(other_key) && met.is_none(),
        "another key"
    );
    kani::cover!(met == Some(entity(1)), "the second one");
}

/// A claim is given up once, and no other claim with it. A session that is over has no time of
/// expiry.
//= SM2-RES-006 kani
// Shows MGR-CLAIM (Exhaustive), bound: 2 claims as above.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(5))]
fn a_claim_is_given_up_once() {
    let mut claims = Claims::new();
    let waiting = [any_claim(), any_claim()];
    kani::assume(waiting[0] != waiting[1]);
    for (at, (link, claim)) in waiting.into_iter().enumerate() {
        assert!(claims.meet(link, entity(at as u64), claim).is_none());
    }
    let (at, link) = (below(3), one_of(&LINKS));
    let there = at < 2 && waiting[at].0 == link;
    assert_eq!(claims.remove(link, entity(at as u64)), there);
    assert!(!claims.remove(link, entity(at as u64)), "once");
    assert_eq!(claims.iter().count(), 2 - usize::from(there));
    assert!(claims.agree());
    let [first, later] = [Instant(5), Instant(6)];
    claims
        .expiring
        .extend([(first, NodeId(1)), (later, NodeId(2))]);
    assert_eq!(claims.deadline(), Some(first));
    claims.forget(first, NodeId(1));
    assert_eq!(claims.deadline(), Some(later));
    kani::cover!(
        there && waiting[0].0 == waiting[1].0,
        "the other claim of its link stays"
    );
}

#[cfg(test)]
kani::explored! {
    only_the_same_claims_meet: 2,
    a_claim_is_given_up_once: 1,
}
