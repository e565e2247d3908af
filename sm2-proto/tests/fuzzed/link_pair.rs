use sm2_proto::fuzz::Script;

use crate::{
    ops::{Op, PairConfig},
    pair::Pair,
};

/// Two correct ends of one link, a topic's or a service's, under operations that the bytes say:
/// no end ever accuses the other, the books of both agree with plain lists after each one, and
/// at rest every message is accounted for.
//= SM2-MSG-001, SM2-MSG-003, SM2-MSG-004, SM2-SEG-004, SM2-QOS-006, SM2-SRV-002 fuzz
pub(crate) fn link_pair(data: &[u8]) {
    let mut script = Script::new(data);
    let Some(mut pair) = pair(&mut script) else {
        return;
    };
    while let Some(op) = op(&mut script) {
        pair.step(&op);
        pair.check();
    }
    pair.run_until_quiet();
    pair.check_settled();
    pair.close();
    pair.check_closed();
}

fn pair(script: &mut Script<'_>) -> Option<Pair> {
    let flags = script.byte()?;
    let sizes = script.byte()?;
    let [a, b, c, d] = [0, 2, 4, 6].map(|shift| 1 + u16::from(sizes >> shift & 3) % 3);
    let config = PairConfig {
        reliable: flags & 1 != 0,
        sealed: flags & 2 != 0,
        depth: [a, b],
        max_borrowed: [c, d],
    };
    Some(if flags & 4 == 0 {
        Pair::topic(config)
    } else {
        Pair::service(config)
    })
}

/// One byte: its kind in five bits, the end in one, a choice in two.
fn op(script: &mut Script<'_>) -> Option<Op> {
    let byte = script.byte()?;
    let end = usize::from(byte >> 5 & 1);
    let pick = usize::from(byte >> 6);
    Some(match byte & 0x1f {
        0..=6 => Op::Send {
            end,
            form: byte % 3,
            pick,
        },
        7..=15 => Op::Carry { end },
        16..=20 => Op::Take { end },
        21..=24 => Op::Release { end, pick },
        25 | 26 => Op::Cancel { pick },
        27 => Op::Retire {
            end,
            segment: u32::from(byte >> 6) % 3,
        },
        28 | 29 => Op::Full {
            end,
            full: byte & 1 != 0,
        },
        30 => Op::Carry { end },
        // All ends, and then nothing happens any more: not by one flipped bit.
        _ => match script.byte()? {
            0xe0 => Op::Close { end, eof: true },
            0xc1 => Op::Close { end, eof: false },
            _ => Op::Take { end },
        },
    })
}
