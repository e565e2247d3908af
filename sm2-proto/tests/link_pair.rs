//! Runs random operations on two ends of one link, joined by queues that lose nothing, and compares
//! them with plain lists of the messages sent and the messages that must arrive.
//!
//! Checks that neither end ever reports a violation by the other, that every message is settled
//! once, and that the counters add up. Keep-last keeps the newest messages, reliable links lose
//! none, each call gets one reply, and no slot is written while it is read.

// Shows LNK-ORDER, LNK-WINDOW, DAT-REFS, DAT-LOCAL (proptest).

use crate::ops::{Op, PairConfig, op, pair_config};
use crate::pair::Pair;
use crate::support::cases;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(1_000).cases, ..ProptestConfig::default() })]

    //= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003, SM2-MSG-004, SM2-MSG-005 test
    //= SM2-PAY-003, SM2-PAY-005, SM2-SEG-004, SM2-SEG-005 test
    //= SM2-QOS-001, SM2-QOS-002, SM2-QOS-006 test
    #[test]
    fn sender_and_receiver(config in pair_config(), ops in prop::collection::vec(op(), 0..250)) {
        run(Pair::topic(config), &ops);
    }

    //= SM2-SRV-001, SM2-SRV-002, SM2-SRV-003, SM2-SRV-004 test
    #[test]
    fn caller_and_server(config in pair_config(), ops in prop::collection::vec(op(), 0..250)) {
        run(Pair::service(config), &ops);
    }
}

fn run(mut pair: Pair, ops: &[Op]) {
    for op in ops {
        pair.step(op);
        pair.check();
    }
    pair.run_until_quiet();
    pair.check_settled();
    pair.close();
    pair.check_closed();
}

/// The receiver takes nothing, so only the window and the queues hold messages back.
#[test]
fn a_subscriber_that_takes_nothing_holds_up_itself_alone() {
    let config = PairConfig {
        reliable: false,
        sealed: false,
        depth: [2, 2],
        max_borrowed: [1, 2],
    };
    let mut pair = Pair::topic(config);
    for _ in 0..100 {
        for op in [
            Op::Send {
                end: 0,
                form: 0,
                pick: 0,
            },
            Op::Carry { end: 0 },
            Op::Carry { end: 1 },
        ] {
            pair.step(&op);
            pair.check();
        }
    }
    pair.run_until_quiet();
    pair.check_settled();
}
