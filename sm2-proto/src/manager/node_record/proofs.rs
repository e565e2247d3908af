//! Harnesses for the record of one node: one step from any state of its tables.

use alloc::{collections::BTreeMap, sync::Arc};

use super::{Farewells, InterfaceRecord, NodeRecord};
use crate::{
    EntityId, InterfaceId, LinkId, Name, NodeId, Refusal, TypeId,
    manager::{Credentials, links::Pair},
    proofs::{below, one_of, subscriber},
};

const OURS: InterfaceId = InterfaceId(4);

fn record() -> NodeRecord {
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    NodeRecord::new(credentials, name())
}

fn name() -> Name {
    Name::new("a").expect("a legal name")
}

/// MGR-IDS: a number of an interface is taken exactly if it is greater than all numbers before it.
/// When the last number is taken, none is left.
//= SM2-IFC-001 kani
// Shows MGR-IDS (BoundariesAndSamples), bound: any two numbers.
#[cfg_attr(kani, kani::proof)]
fn interface_numbers_grow() {
    let mut record = record();
    let (last, wanted): (u64, u64) = kani::any();
    record.last_interface = InterfaceId(last);
    let verdict = record.number(InterfaceId(wanted));
    let grows = wanted > last;
    let expected = if grows {
        Ok(())
    } else {
        Err(violation!(BadInterfaceId, "SM2-IFC-001"))
    };
    assert_eq!(verdict, expected);
    let latest = if grows { wanted } else { last };
    assert_eq!(record.last_interface, InterfaceId(latest));
    assert!(!grows || wanted > 0);
    let again = record.number(InterfaceId(wanted));
    assert_eq!(
        again,
        Err(violation!(BadInterfaceId, "SM2-IFC-001")),
        "never used twice"
    );
    kani::cover!(wanted == u64::MAX && grows, "the last number");
    kani::cover!(last == u64::MAX, "no number is left");
}

/// The stages of a link's end.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Gone,
    /// Claimed, without a counterpart.
    Half,
    Joined,
    /// UNLINK was sent, and UNLINKED is only its answer.
    Unlinking,
    /// As `Unlinking`, but UNLINKED may tell of a shortage.
    Crossing,
}

const STAGES: [Stage; 5] = [
    Stage::Gone,
    Stage::Half,
    Stage::Joined,
    Stage::Unlinking,
    Stage::Crossing,
];

const LINKS: [LinkId; 2] = [
    LinkId {
        epoch: 1,
        serial: 1,
    },
    LinkId {
        epoch: 2,
        serial: 1,
    },
];

const PAIR: Pair = Pair {
    offering: EntityId::node(NodeId(8)),
    demanding: EntityId::node(NodeId(9)),
};

fn books(stages: [Stage; 2]) -> NodeRecord {
    let mut record = record();
    let mut interface = InterfaceRecord {
        contract: Arc::new(subscriber()),
        suspended: None,
        live: BTreeMap::new(),
        unlinking: BTreeMap::new(),
        known: 0,
    };
    for (link, stage) in LINKS.into_iter().zip(stages) {
        match stage {
            Stage::Gone => continue,
            Stage::Half => drop(interface.live.insert(link, None)),
            Stage::Joined => drop(interface.live.insert(link, Some(PAIR))),
            Stage::Unlinking => drop(interface.unlinking.insert(link, None)),
            Stage::Crossing => drop(interface.unlinking.insert(link, Some(PAIR))),
        }
        record.link_ends += 1;
        record.known_ends += 1;
        interface.known += 1;
    }
    record.interfaces.insert(OURS, interface);
    record
}

/// A link that could not be made is taken back.
fn takes_back(record: &mut NodeRecord, link: LinkId, live: bool) {
    record.remove_link(OURS, link);
    if live {
        record.not_announced(OURS);
    }
}

/// The whole interface is gone, with its links at these stages.
fn withdraws(record: &mut NodeRecord, stages: [Stage; 2]) {
    let (_, remains) = record.withdraw(OURS).expect("it is there");
    let lives = |it: &&Stage| matches!(it, Stage::Half | Stage::Joined);
    assert_eq!(remains.len(), stages.iter().filter(lives).count());
    assert_eq!((record.link_ends(), record.known_ends), (0, 0));
    assert_eq!(record.interfaces(), 0);
    assert!(record.withdraw(OURS).is_none());
}

/// Each end of a link has one farewell in each direction, and counts until both are said.
//= SM2-LNK-003, SM2-LNK-009, SM2-RES-006, SM2-IFC-003 kani
// Shows LNK-FAREWELL (Exhaustive), bound: one step from any state of 2 links of an interface.
#[cfg_attr(kani, kani::proof)]
// Two links of one interface.
#[cfg_attr(kani, kani::unwind(5))]
fn farewells_of_a_links_end() {
    let mut stages = [one_of(&STAGES), one_of(&STAGES)];
    let mut record = books(stages);
    assert!(record.counts_its_ends() && record.counts_known_ends(|_| false));
    let stage = stages[0];
    let live = matches!(stage, Stage::Half | Stage::Joined);
    let link = LINKS[0];
    match below(6) {
        0 => {
            let verdict = record.farewell(OURS, link);
            let expected = match stage {
                Stage::Gone => Err(violation!(UnknownLink, "SM2-LNK-003")),
                Stage::Half => Ok(Farewells::First(None)),
                Stage::Joined => Ok(Farewells::First(Some(PAIR))),
                Stage::Unlinking => Ok(Farewells::Second(None)),
                Stage::Crossing => Ok(Farewells::Second(Some(PAIR))),
            };
            assert_eq!(verdict, expected);
            let again = record.farewell(OURS, link);
            assert_eq!(
                again,
                Err(violation!(UnknownLink, "SM2-LNK-003")),
                "never named again"
            );
            let other = record.farewell(InterfaceId(5), link);
            assert_eq!(other, Err(violation!(UnknownInterface, "SM2-LNK-003")));
            stages[0] = Stage::Gone;
            kani::cover!(
                expected == Ok(Farewells::Second(Some(PAIR))),
                "both are said"
            );
        }
        1 => {
            let pair = one_of(&[None, Some(PAIR)]);
            assert_eq!(record.begin_unlink(OURS, link, pair), live);
            stages[0] = match (live, pair) {
                (true, Some(_)) => Stage::Crossing,
                (true, None) => Stage::Unlinking,
                (false, _) => stage,
            };
        }
        2 => {
            // Only a link that was just made, and that the node was not told of, is taken back.
            takes_back(&mut record, link, live);
            stages[0] = if live { Stage::Gone } else { stage };
        }
        3 => {
            // A number that was told to the node is not used again.
            kani::assume(!matches!(stage, Stage::Unlinking | Stage::Crossing));
            record.link(OURS, link, PAIR);
            if stage == Stage::Gone {
                record.know(OURS);
            }
            stages[0] = Stage::Joined;
            kani::cover!(stage == Stage::Half, "adopted");
        }
        4 => {
            let has = record.has_link(OURS, link);
            assert_eq!(has, Some(stage != Stage::Gone));
            assert_eq!(record.has_link(InterfaceId(5), link), None);
        }
        _ => {
            withdraws(&mut record, stages);
            return;
        }
    }
    assert!(record == books(stages));
    assert!(record.counts_its_ends() && record.counts_known_ends(|_| false));
}

/// The refusals and texts that are remembered stay within their quotas. The oldest refusal is
/// forgotten first.
//= SM2-WCH-004, SM2-SCH-001 kani
// Shows MGR-QUOTA (BoundariesAndSamples), bound: up to 3 refusals; any bytes and quota.
#[cfg_attr(kani, kani::proof)]
// At most three refusals; names of one byte.
#[cfg_attr(kani, kani::unwind(5))]
fn memory_of_a_node_is_bounded() {
    let mut record = record();
    if kani::any() {
        let limit = below(4);
        let before = below(limit + 1);
        for number in 0..before as u64 {
            let refusal = (subscriber(), Refusal::NameTaken);
            record.refused.insert(InterfaceId(1 + number), refusal);
        }
        let forgotten = record.refuse(InterfaceId(9), subscriber(), Refusal::NameTaken, limit);
        assert_eq!(record.refused().len(), limit.min(before + 1));
        let oldest = InterfaceId(if before == 0 { 9 } else { 1 });
        assert_eq!(forgotten, (before == limit).then_some(oldest));
        kani::cover!(limit == 0, "nothing is remembered");
        kani::cover!(
            before == 3 && forgotten.is_some(),
            "the oldest is forgotten"
        );
    } else {
        // Both are at most the quota, which is an operator's number of bytes.
        let half = usize::MAX / 2;
        let quota = kani::any_where(|quota: &usize| *quota <= half);
        let used = kani::any_where(|used: &usize| *used <= quota);
        let cost = kani::any_where(|cost: &usize| *cost <= half);
        let (name, known) = (name(), kani::any());
        let data = TypeId { name, hash: 1 };
        record.schema_bytes = used;
        record
            .schemas
            .extend(if known { Some(data.clone()) } else { None });
        let kept = record.register(&data, cost, quota);
        assert_eq!(kept, !known && used + cost <= quota);
        assert_eq!(record.schema_bytes, if kept { used + cost } else { used });
        assert!(record.schema_bytes <= quota);
        assert_eq!(record.schemas().count(), usize::from(kept || known));
        kani::cover!(kept && used + cost == quota, "used up");
        kani::cover!(!kept && !known, "beyond the quota");
    }
}

#[cfg(test)]
kani::explored! {
    interface_numbers_grow: 2,
    farewells_of_a_links_end: 2,
    memory_of_a_node_is_bounded: 4,
}
