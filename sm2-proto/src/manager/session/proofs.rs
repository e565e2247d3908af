//! Harnesses for one session: one step from any state of its books.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use super::{Farewells, Interface, Resumption, Session};
use crate::{
    EntityId, InterfaceId, LinkId, Name, NodeId, Refusal, TypeId,
    limits::LINKS_MAX,
    manager::{Credentials, links::Pair},
    proofs::{below, one_of, subscriber},
};

const OURS: InterfaceId = InterfaceId(4);

fn session() -> Session {
    Session::new(Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    })
}

fn name() -> Name {
    Name::new("a").expect("a legal name")
}

/// MGR-IDS: a number of an interface is taken exactly if it is greater than all before it,
/// whatever they were; when the last one is taken, none is left.
//= SM2-IFC-001 kani
#[cfg_attr(kani, kani::proof)]
fn interface_numbers_grow() {
    let mut session = session();
    let (last, wanted): (u64, u64) = kani::any();
    session.last_interface = last;
    let verdict = session.number(InterfaceId(wanted));
    let grows = wanted > last;
    let expected = if grows {
        Ok(())
    } else {
        Err(violation!(InterfaceNumber, "SM2-IFC-001"))
    };
    assert_eq!(verdict, expected);
    assert_eq!(session.last_interface, if grows { wanted } else { last });
    assert!(!grows || wanted > 0);
    let again = session.number(InterfaceId(wanted));
    assert_eq!(
        again,
        Err(violation!(InterfaceNumber, "SM2-IFC-001")),
        "never used twice"
    );
    kani::cover!(wanted == u64::MAX && grows, "the last number");
    kani::cover!(last == u64::MAX, "no number is left");
}

/// Where the end of a link stands.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Gone,
    /// Claimed, without a counterpart.
    Half,
    Joined,
    Told,
}

const STAGES: [Stage; 4] = [Stage::Gone, Stage::Half, Stage::Joined, Stage::Told];

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

fn books(stages: [Stage; 2]) -> Session {
    let mut session = session();
    let mut interface = Interface {
        contract: Arc::new(subscriber()),
        live: BTreeMap::new(),
        told: BTreeSet::new(),
    };
    for (link, stage) in LINKS.into_iter().zip(stages) {
        match stage {
            Stage::Gone => continue,
            Stage::Half => drop(interface.live.insert(link, None)),
            Stage::Joined => drop(interface.live.insert(link, Some(PAIR))),
            Stage::Told => drop(interface.told.insert(link)),
        }
        session.link_ends += 1;
    }
    session.interfaces.insert(OURS, interface);
    session
}

/// Each end of a link has one farewell in each direction, and counts until both are said.
//= SM2-LNK-003, SM2-RES-006, SM2-IFC-003 kani
#[cfg_attr(kani, kani::proof)]
// Two links of one interface.
#[cfg_attr(kani, kani::unwind(5))]
fn farewells_of_a_links_end() {
    let mut stages = [one_of(&STAGES), one_of(&STAGES)];
    let mut session = books(stages);
    assert!(session.counts_its_ends());
    let stage = stages[0];
    let live = matches!(stage, Stage::Half | Stage::Joined);
    let link = LINKS[0];
    match below(6) {
        0 => {
            let verdict = session.farewell(OURS, link);
            let expected = match stage {
                Stage::Gone => Err(violation!(UnknownLink, "SM2-LNK-003")),
                Stage::Half => Ok(Farewells::First(None)),
                Stage::Joined => Ok(Farewells::First(Some(PAIR))),
                Stage::Told => Ok(Farewells::Both),
            };
            assert_eq!(verdict, expected);
            let again = session.farewell(OURS, link);
            assert_eq!(
                again,
                Err(violation!(UnknownLink, "SM2-LNK-003")),
                "never named again"
            );
            let other = session.farewell(InterfaceId(5), link);
            assert_eq!(other, Err(violation!(UnknownInterface, "SM2-LNK-003")));
            stages[0] = Stage::Gone;
            kani::cover!(expected == Ok(Farewells::Both), "both are said");
        }
        1 => {
            session.tell(OURS, link);
            stages[0] = if live { Stage::Told } else { stage };
        }
        2 => {
            // Only a link that was just made, and never told of, is taken back.
            session.unlink(OURS, link);
            stages[0] = if live { Stage::Gone } else { stage };
        }
        3 => {
            // What was told of is over: its number is not used again.
            kani::assume(stage != Stage::Told);
            session.link(OURS, link, PAIR);
            stages[0] = Stage::Joined;
            kani::cover!(stage == Stage::Half, "adopted");
        }
        4 => {
            let has = session.has_link(OURS, link);
            assert_eq!(has, Some(stage != Stage::Gone));
            let other = session.has_link(InterfaceId(5), link);
            assert_eq!(other, None);
        }
        _ => {
            let (_, remains) = session.withdraw(OURS).expect("it is there");
            let lives = |it: &&Stage| matches!(it, Stage::Half | Stage::Joined);
            assert_eq!(remains.len(), stages.iter().filter(lives).count());
            assert_eq!((session.link_ends(), session.interfaces()), (0, 0));
            assert!(session.withdraw(OURS).is_none());
            return;
        }
    }
    assert!(session == books(stages));
    assert!(session.counts_its_ends());
}

/// A session may claim as many links as there can be, and only until CLAIMED.
//= SM2-RES-003, SM2-RES-008 kani
#[cfg_attr(kani, kani::proof)]
fn claims_are_bounded() {
    let mut session = session();
    let claims = kani::any_where(|claims: &usize| *claims < usize::MAX);
    let resuming = kani::any();
    session.resumption = if resuming {
        Some(Resumption {
            claims,
            ..Resumption::default()
        })
    } else {
        None
    };
    assert_eq!(session.may_claim(), resuming && claims < LINKS_MAX);
    session.settle();
    let ended = session.settling.as_ref().map(|it| it.ended.len());
    assert_eq!(ended, Some(0), "no pair was left out");
    assert!(!session.may_claim(), "all is claimed");
    kani::cover!(resuming && claims == LINKS_MAX, "one too many");
    kani::cover!(resuming && claims < LINKS_MAX, "a claim");
}

/// What is remembered of refusals and of texts stays within its quota; the oldest refusal is
/// forgotten first.
//= SM2-WCH-004, SM2-SCH-001 kani
#[cfg_attr(kani, kani::proof)]
// At most three refusals; names of one byte.
#[cfg_attr(kani, kani::unwind(5))]
fn memory_of_a_session_is_bounded() {
    let mut session = session();
    if kani::any() {
        let limit = below(4);
        let before = below(limit + 1);
        for number in 0..before as u64 {
            let refusal = (subscriber(), Refusal::NameTaken);
            session.refused.insert(InterfaceId(1 + number), refusal);
        }
        let forgotten = session.refuse(InterfaceId(9), subscriber(), Refusal::NameTaken, limit);
        assert_eq!(session.refused().len(), limit.min(before + 1));
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
        session.schema_bytes = used;
        session
            .schemas
            .extend(if known { Some(data.clone()) } else { None });
        let kept = session.register(&data, cost, quota);
        assert_eq!(kept, !known && used + cost <= quota);
        assert_eq!(session.schema_bytes, if kept { used + cost } else { used });
        assert!(session.schema_bytes <= quota);
        assert_eq!(session.schemas().count(), usize::from(kept || known));
        kani::cover!(kept && used + cost == quota, "used up");
        kani::cover!(!kept && !known, "beyond the quota");
    }
}

#[cfg(test)]
kani::explored! {
    interface_numbers_grow: 2,
    farewells_of_a_links_end: 2,
    claims_are_bounded: 2,
    memory_of_a_session_is_bounded: 4,
}
