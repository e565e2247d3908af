//! Runs random operations on two ends of one link of the ring lane, also in the middle of each
//! other's operations, and compares them with plain lists of the sent, taken and displaced
//! messages. The ends are joined by one ring and by sockets that lose nothing.

// Shows RNG-FIFO, RNG-WAKE, DAT-REFS, LNK-FATES (proptest), bound: both ends, any operation in the middle of another.

use crate::ring_support::pair::{Op, Pair};
use crate::support::cases;
use proptest::prelude::*;

fn op() -> impl Strategy<Value = Op> {
    let (end, segment, at) = (0_usize..2, 0_u32..3, 0_u32..15);
    let within = prop_oneof![Just(None), segment.clone().prop_map(Some)];
    let few = 1_u8..7;
    prop_oneof![
        60 => within.clone().prop_map(|within| Op::Send { within }),
        20 => (at.clone(), few.clone(), within.clone())
            .prop_map(|(at, takes, within)| Op::SendWhile { at, takes, within }),
        20 => (at.clone(), few.clone(), within.clone())
            .prop_map(|(at, sends, within)| Op::TakeWhile { at, sends, within }),
        10 => (0_u32..4, few, 0_usize..4, within.clone())
            .prop_map(|(at, sends, pick, within)| Op::ReleaseWhile { at, sends, pick, within }),
        60 => end.clone().prop_map(|end| Op::Carry { end }),
        50 => Just(Op::Take),
        40 => (0_usize..4).prop_map(|pick| Op::Release { pick }),
        15 => Just(Op::Harvest),
        10 => segment.prop_map(|segment| Op::Retire { segment }),
        8 => (end.clone(), any::<bool>()).prop_map(|(end, full)| Op::Full { end, full }),
        20 => end.clone().prop_map(|end| Op::Park { end }),
        1 => end.clone().prop_map(|end| Op::Close { end }),
        1 => (end, at, within).prop_map(|(end, at, within)| Op::Kill { end, at, within }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(400).cases, ..ProptestConfig::default() })]

    //= SM2-RNG-002, SM2-RNG-005, SM2-RNG-006, SM2-RNG-007, SM2-RNG-008 test
    //= SM2-RNG-012, SM2-RNG-009, SM2-RNG-010, SM2-RNG-013, SM2-OPN-010, SM2-PAY-005 test
    #[test]
    fn ring_pair(
        reliable: bool,
        depth in 1_u16..5,
        max_borrowed in 1_u16..4,
        ops in prop::collection::vec(op(), 0..300),
    ) {
        let mut pair = Pair::new(reliable, depth, max_borrowed);
        for op in ops {
            pair.step(op);
            pair.check();
        }
        pair.run_until_quiet();
    }
}
