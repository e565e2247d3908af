//! Harnesses for the numbers of links, from any count, and for the tables, from any three links.

use super::{Agreed, EntityId, LinkId, LinkQos, Links, Pair};
use crate::{
    NodeId, VERSION,
    proofs::{below, one_of},
};

const OURS: LinkId = LinkId {
    epoch: 7,
    serial: 1,
};

/// Two links of another Manager, claimed under one number.
const ADOPTED: LinkId = LinkId {
    epoch: 6,
    serial: 1,
};

const fn pair(offering: u64, demanding: u64) -> Pair {
    Pair {
        offering: EntityId::node(NodeId(offering)),
        demanding: EntityId::node(NodeId(demanding)),
    }
}

const LINKS: [(LinkId, Pair); 3] = [
    (OURS, pair(1, 2)),
    (ADOPTED, pair(2, 1)),
    (ADOPTED, pair(3, 4)),
];

const AGREED: Agreed = Agreed {
    version: VERSION,
    qos: LinkQos {
        reliable: true,
        sealed: false,
    },
};

fn links(live: [bool; 3]) -> Links {
    let mut links = Links::new(OURS.epoch, 5);
    for ((link, pair), _) in LINKS.into_iter().zip(live).filter(|(_, is)| *is) {
        links
            .live
            .insert((link, pair.offering), (pair.demanding, AGREED));
        links.pairs.insert(pair);
    }
    links
}

/// A pair has one link, a link ends once, and adopted links with one number are told apart. Only
/// links that this Manager made can fail to be made.
//= SM2-MAT-002, SM2-RES-004, SM2-RES-005 kani
// Shows MGR-INV (Exhaustive), bound: one step from any state of 3 links.
#[cfg_attr(kani, kani::proof)]
// Three links.
#[cfg_attr(kani, kani::unwind(6))]
fn a_pair_has_one_link() {
    let mut live: [bool; 3] = kani::any();
    let mut links = links(live);
    assert!(links.agree());
    let at = below(3);
    let ((link, pair), is_live) = (LINKS[at], live[at]);
    assert_eq!(links.joins(pair), is_live);
    assert_eq!(links.item(link, pair.offering).is_some(), is_live);
    match below(3) {
        0 => {
            kani::assume(!is_live);
            links.insert(link, pair, AGREED);
            live[at] = true;
            kani::cover!(at == 2 && live[1], "two of one number");
        }
        1 => {
            // A pair and the number of another link together end nothing.
            let other = one_of(&LINKS).0;
            let found = links.remove(other, pair);
            assert_eq!(found, is_live && other == link);
            live[at] = is_live && !found;
        }
        _ => {
            let made = links.made(link);
            assert_eq!(made, (at == 0 && is_live).then_some(pair));
            kani::cover!(made.is_none() && is_live, "adopted");
        }
    }
    assert!(links == self::links(live));
    assert!(links.agree());
}

//= SM2-LNK-002 kani
// Shows MGR-IDS (BoundariesAndSamples), bound: two numbers from any count below 2^64 - 2.
#[cfg_attr(kani, kani::proof)]
fn link_numbers_grow() {
    let mut links = Links::new(kani::any(), kani::any());
    links.last_serial = kani::any_where(|last: &u64| *last < u64::MAX - 1);
    let before = links.last_serial;
    let (one, key) = links.number();
    let (two, other_key) = links.number();
    assert!(before < one.serial && one.serial < two.serial);
    assert!(one.epoch == links.epoch() && two.epoch == links.epoch());
    kani::cover!(before > u64::from(u32::MAX), "a count beyond 32 bits");
    kani::cover!(key != other_key, "keys differ");
}

#[cfg(test)]
kani::explored! {
    link_numbers_grow: 2,
    a_pair_has_one_link: 2,
}
