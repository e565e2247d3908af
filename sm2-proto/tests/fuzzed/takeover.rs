use sm2_proto::{Contract, LinkKey, fuzz::Script};

use crate::{
    claims_oracle::Said,
    claims_play::{INTERFACES, Op, Play, SLOTS},
    support::contracts::{data, publisher_with, subscriber_with},
    takeover::{NODES, World},
};

/// Managers that take over from each other, in two kinds of runs. If the first byte is odd, correct
/// nodes reconnect, and frames in flight may be lost: no side is accused, and links that neither
/// end closed stay. If it is even, sessions make arbitrary claims, which are compared with an
/// oracle of plain lists.
//= SM2-RES-001, SM2-RES-002, SM2-RES-004, SM2-RES-005, SM2-RES-006, SM2-RES-007 fuzz
//= SM2-NOD-003, SM2-LNK-003, SM2-MAT-002 fuzz
pub(crate) fn takeover(bytes: &[u8]) {
    let mut script = Script::new(bytes);
    let Some(flags) = script.byte() else {
        return;
    };
    if flags & 1 == 0 {
        let mut play = Play::new(flags & 2 != 0);
        while let Some(op) = claim_op(&mut script) {
            play.step(&op);
        }
        return;
    }
    let mut world = World::new();
    while history(&mut world, &mut script).is_some() {}
    world.run_until_quiet();
    world.check();
}

/// A topic of two, with a type that nearly always fits.
fn contract(script: &mut Script<'_>) -> Option<Contract> {
    let choice = script.byte()?;
    Some(contract_of(choice, if choice < 0xf0 { "A" } else { "B" }))
}

fn contract_of(choice: u8, data_name: &str) -> Contract {
    let [offers, other, reliable, sealed] = [1, 2, 4, 8].map(|bit| choice & bit != 0);
    let topic = if other { "image" } else { "scan" };
    let data = data(data_name);
    if offers {
        publisher_with(topic, &data, reliable, sealed)
    } else {
        subscriber_with(topic, Some(&data), reliable, sealed)
    }
}

/// One event of the domain.
fn history(world: &mut World, script: &mut Script<'_>) -> Option<()> {
    let byte = script.byte()?;
    let node = usize::from(byte >> 5) % NODES;
    match byte & 0x1f {
        0..=3 => world.declare(node, contract(script)?),
        4 => world.withdraw(node, script.below(4)?),
        5 => world.break_link(node, script.below(4)?),
        6 | 7 => world.notice(node),
        8..=15 => drop(world.manager_reads(node)),
        16..=23 => drop(world.node_reads(node)),
        24 => world.kill(script.below(6)?),
        25 => world.shutdown(),
        26 | 27 => world.start(),
        28 | 29 => world.reconnect(node),
        30 => world.stall(node),
        _ => {
            world.run_until_quiet();
            world.check();
        }
    }
    Some(())
}

/// One action of a session.
fn claim_op(script: &mut Script<'_>) -> Option<Op> {
    let byte = script.byte()?;
    let at = usize::from(byte >> 6) % SLOTS;
    Some(match byte & 0x1f {
        0..=3 => {
            let choice = script.byte()?;
            Op::Join(at, choice % 5 != 0, 1 + u32::from(choice >= 0xe0))
        }
        4 => Op::Leave(at),
        // One type for all, because the oracle of claims knows no refusals.
        5..=12 => Op::Declare(at, contract_of(script.byte()?, "A")),
        13 => Op::Withdraw(at, interface(script)?),
        14..=24 => {
            let interface = interface(script)?;
            let choice = script.byte()?;
            let said = Said {
                serial: 1 + u64::from(choice % 3),
                key: LinkKey(u64::from(choice >> 2 & 3 == 3)),
                reliable: choice >> 4 & 3 == 3,
                sealed: choice & 0x40 != 0,
            };
            Op::Claim(at, interface, said)
        }
        25 | 26 => Op::Claimed(at),
        27..=29 => Op::Unlinked(at, script.below(6)?),
        _ => Op::Wait(12 * u64::from(script.byte()?)),
    })
}

fn interface(script: &mut Script<'_>) -> Option<u64> {
    Some(1 + u64::from(script.byte()?) % INTERFACES)
}
