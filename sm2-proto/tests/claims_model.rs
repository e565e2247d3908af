//! Random claims of a few sessions, honest and not, against an oracle of SPEC section 11 that
//! consists of a few lists: the links, the claims that wait, and the frames to each node.

// Shows MGR-CLAIM, CLI-SURVIVE, MGR-STRICT (proptest), bound: claims, honest and not.

use crate::claims_oracle::Said;
use crate::claims_play::{INTERFACES, Op, Play, SLOTS};
use crate::support::{
    cases,
    contracts::{data, publisher_with, subscriber_with},
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::Contract;
use sm2_proto::LinkKey;

fn contract() -> impl Strategy<Value = Contract> {
    any::<[bool; 4]>().prop_map(|[offers, other, reliable, sealed]| {
        let topic = if other { "map" } else { "scan" };
        if offers {
            publisher_with(topic, &data("T"), reliable, sealed)
        } else {
            subscriber_with(topic, None, reliable, sealed)
        }
    })
}

fn said() -> impl Strategy<Value = Said> {
    let rarely = || prop_oneof![4 => Just(false), 1 => Just(true)];
    (1..4_u64, rarely(), rarely(), any::<bool>()).prop_map(|(serial, key, reliable, sealed)| Said {
        serial,
        key: LinkKey(u64::from(key)),
        reliable,
        sealed,
    })
}

fn op() -> impl Strategy<Value = Op> {
    let slot = || 0..SLOTS;
    let uid = || prop_oneof![6 => Just(1_u32), 1 => Just(2)];
    prop_oneof![
        5 => (slot(), prop_oneof![4 => Just(true), 1 => Just(false)], uid())
            .prop_map(|(at, back, uid)| Op::Join(at, back, uid)),
        1 => slot().prop_map(Op::Leave),
        10 => (slot(), contract()).prop_map(|(at, it)| Op::Declare(at, it)),
        1 => (slot(), 1..=INTERFACES).prop_map(|(at, it)| Op::Withdraw(at, it)),
        16 => (slot(), 1..=INTERFACES, said()).prop_map(|(at, it, said)| Op::Claim(at, it, said)),
        3 => slot().prop_map(Op::Claimed),
        4 => (slot(), 0..6_usize).prop_map(|(at, pick)| Op::Unlinked(at, pick)),
        1 => (0..3_000_u64).prop_map(Op::Wait),
    ]
}

proptest! {
    #![proptest_config(cases(600))]

    //= SM2-RES-002, SM2-RES-003, SM2-RES-004, SM2-RES-005, SM2-RES-006, SM2-RES-007 test
    //= SM2-LNK-003, SM2-LNK-009, SM2-SES-004 test
    #[test]
    fn claims(seal_all in any::<bool>(), ops in vec(op(), 1..120)) {
        let mut play = Play::new(seal_all);
        for op in ops {
            play.step(&op);
        }
    }
}
