//! Harnesses for one interface of a node: one step from any state, by the table of SPEC section 4.3.

use alloc::collections::BTreeMap;

use super::{Answer, Answered, Interface, Judged, Link, Misuse, Standing, State, Withdrawal};
use crate::{
    Contract, DemandedQos, InterfaceId, LinkId, LinkKey, LinkQos, Name, NodeId, OfferedQos, TypeId,
    VERSION,
    control::LinkPeer,
    proofs::{below, one_of},
};

const STATES: [State; 8] = [
    State::Queued,
    State::Declaring,
    State::Dormant,
    State::Renewing,
    State::WithdrawalQueued,
    State::Live,
    State::Suspended,
    State::Dropping,
];

/// The rows of SPEC section 4.3, and a row for interfaces that the Manager has not heard of in
/// this session.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Row {
    Unheard,
    Declaring,
    Live,
    Suspended,
    Dropping,
}

const fn row(state: State) -> Row {
    match state {
        State::Queued | State::Dormant => Row::Unheard,
        State::Declaring | State::Renewing | State::WithdrawalQueued => Row::Declaring,
        State::Live => Row::Live,
        State::Suspended => Row::Suspended,
        State::Dropping => Row::Dropping,
    }
}

/// Two links, made by two Managers.
const LINKS: [LinkId; 2] = [
    LinkId {
        epoch: 1,
        serial: 9,
    },
    LinkId {
        epoch: 2,
        serial: 3,
    },
];

const TERMS: Link = Link {
    key: LinkKey(5),
    version: VERSION,
    qos: LinkQos {
        reliable: false,
        sealed: false,
    },
};

fn topic() -> Name {
    Name::new("a").expect("a legal name")
}

fn data() -> TypeId {
    let name = topic();
    TypeId { name, hash: 1 }
}

fn publisher(reliable: bool, sealed: bool) -> Contract {
    Contract::Publisher {
        topic: topic(),
        data: data(),
        offer: OfferedQos {
            reliable,
            sealed,
            ..OfferedQos::new(1)
        },
    }
}

fn subscriber(topic: Name, reliable: bool, sealed: bool) -> LinkPeer {
    LinkPeer {
        node: NodeId(1),
        name: data().name,
        interface: InterfaceId(1),
        contract: Contract::Subscriber {
            topic,
            data: None,
            demand: DemandedQos {
                reliable,
                sealed,
                ..DemandedQos::new(1, 1)
            },
        },
    }
}

fn interface(state: State, standings: [Option<Standing>; 2]) -> Interface {
    let links = LINKS.into_iter().zip(standings);
    let links: BTreeMap<_, _> = links
        .filter_map(|(id, standing)| Some((id, (standing?, TERMS))))
        .collect();
    Interface {
        contract: publisher(false, false),
        state,
        links,
    }
}

/// A link's end in any standing that the interface's state allows.
fn any_standing(state: State) -> Option<Standing> {
    let standing = one_of(&[
        None,
        Some(Standing::Unclaimed),
        Some(Standing::Known),
        Some(Standing::Left),
    ]);
    kani::assume(match state {
        // No Manager has ever granted the interface.
        State::Queued | State::Declaring => standing.is_none(),
        // All its links are of earlier sessions.
        State::Dormant | State::Renewing | State::WithdrawalQueued => {
            matches!(standing, None | Some(Standing::Unclaimed))
        }
        // Links that were not claimed end with the suspension.
        State::Suspended => standing != Some(Standing::Unclaimed),
        State::Live | State::Dropping => true,
    });
    standing
}

/// A state that this session's Manager has not heard of, or that it has to answer, knows, or
/// forgets.
pub(in crate::node) fn any_interface() -> Interface {
    let state = one_of(&STATES);
    interface(state, [any_standing(state), any_standing(state)])
}

/// Whether the interface stands in the queue of DECLAREs without an answer.
pub(in crate::node) fn is_declaring(interface: &Interface) -> bool {
    row(interface.state) == Row::Declaring
}

/// Whether DECLARED or DECLARE_REFUSED, with a denial or another reason, may tell of a new access policy.
pub(in crate::node) fn may_be_judged(
    interface: &Interface,
    is_allowed: bool,
    is_denial: bool,
) -> bool {
    match row(interface.state) {
        Row::Unheard | Row::Declaring => false,
        Row::Live => !is_allowed && is_denial,
        Row::Suspended | Row::Dropping => true,
    }
}

/// Whether the interface may be in this state without a session.
pub(in crate::node) fn is_unheard(interface: &Interface) -> bool {
    row(interface.state) == Row::Unheard
}

/// Whether the interface may be in this state while the session is resumed, or (false) afterwards.
pub(in crate::node) fn fits(interface: &Interface, resuming: bool) -> bool {
    match interface.state {
        State::Queued => resuming,
        State::Declaring => !resuming,
        State::Renewing | State::WithdrawalQueued => resuming,
        State::Dormant | State::Dropping | State::Suspended => true,
        // All links of earlier sessions are claimed by then.
        State::Live => {
            let mut standings = interface.links.values().map(|(standing, _)| *standing);
            resuming || standings.all(|it| it != Standing::Unclaimed)
        }
    }
}

/// Whether LINK of an unknown link, and UNLINK of the first one, are legal now, and whether they
/// have an effect. They have none if they crossed WITHDRAW. `None`: neither is legal.
pub(in crate::node) fn expected_link(interface: &Interface) -> Option<bool> {
    match row(interface.state) {
        Row::Unheard | Row::Declaring => None,
        Row::Live | Row::Suspended => Some(true),
        Row::Dropping => Some(false),
    }
}

/// CLI-DROPPING and the other rows: the frames that the Manager may send about an interface.
//= SM2-IFC-002, SM2-IFC-004, SM2-LNK-003, SM2-LNK-004, SM2-RES-010 kani
// Shows CLI-DROPPING (Exhaustive), bound: one step from any of 8 states with 2 links.
#[cfg_attr(kani, kani::proof)]
// Two links; names of one byte.
#[cfg_attr(kani, kani::unwind(4))]
fn interface_table() {
    let mut it = any_interface();
    let (before, at) = (it.clone(), row(it.state));
    let standing = it.links.get(&LINKS[0]).map(|(standing, _)| *standing);
    kani::cover!(
        at == Row::Dropping && standing.is_some(),
        "a link of a dropped interface"
    );
    match below(5) {
        0 => {
            let answer = it.declared();
            assert_eq!(answer.is_ok(), at == Row::Declaring);
            if before.state == State::WithdrawalQueued {
                assert!(answer == Ok(Answered::WithdrawalQueued) && it.state == State::Dropping);
            } else if answer.is_ok() {
                assert!(it.state == State::Live);
                let first = before.state == State::Declaring;
                assert_eq!(answer == Ok(Answered::First), first);
            }
        }
        1 => {
            let is_denial = kani::any();
            let answer = it.refused(is_denial);
            assert_eq!(answer.is_ok(), at == Row::Declaring);
            // An interface that was granted before stays. It is declared again in the next session,
            // unless the Manager keeps it.
            if answer == Ok(Answered::Renewed) {
                assert!(before.state == State::Renewing);
                let stays = [State::Dormant, State::Suspended][usize::from(is_denial)];
                assert!(it.state == stays && it.links == before.links);
            }
        }
        2 => {
            assert_eq!(it.withdrawn().is_ok(), at == Row::Dropping);
        }
        3 => {
            let peer = subscriber(topic(), false, false);
            let expected = if !matches!(at, Row::Live | Row::Dropping) {
                Err(violation!(UnknownInterface, "SM2-LNK-004"))
            } else if standing.is_some() {
                Err(violation!(BadLinkId, "SM2-LNK-004"))
            } else {
                Ok(at == Row::Live)
            };
            assert_eq!(it.link(LINKS[0], TERMS, &peer), expected);
            let known = expected.is_ok().then_some(Standing::Known).or(standing);
            let now = it.links.get(&LINKS[0]).map(|(standing, _)| *standing);
            assert!(now == known);
            kani::cover!(expected == Ok(false), "LINK that crossed WITHDRAW");
        }
        _ => {
            let expected = match (at, standing) {
                (Row::Unheard | Row::Declaring, _) => {
                    Err(violation!(UnknownInterface, "SM2-LNK-003"))
                }
                (_, None | Some(Standing::Unclaimed)) => {
                    Err(violation!(UnknownLink, "SM2-LNK-003"))
                }
                (Row::Dropping, Some(_)) => Ok(Answer::Nothing),
                (_, Some(Standing::Known)) => Ok(Answer::Unlinked),
                (_, Some(Standing::Left)) => Ok(Answer::Crossed),
            };
            assert_eq!(it.unlink(LINKS[0]), expected);
            assert!(it.unlink(LINKS[0]).is_err(), "one farewell each way");
            kani::cover!(expected == Ok(Answer::Unlinked), "the Manager was first");
        }
    }
    assert!(it.state == before.state || at == Row::Declaring);
}

/// A new access policy changes an interface that the Manager keeps, and no other one.
//= SM2-ACC-013 kani
// Shows CLI-DROPPING (Exhaustive), bound: one step from any of 8 states with 2 links.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn policies_judge_kept_interfaces() {
    let mut it = any_interface();
    let (before, at) = (it.clone(), row(it.state));
    let is_allowed = kani::any();
    let judged = match is_allowed {
        true => it.allowed(),
        false => it.denied(true),
    };
    let expected = match (at, is_allowed) {
        (Row::Dropping, _) => Ok(Judged::Nothing),
        (Row::Suspended, _) | (Row::Live, false) => Ok(Judged::Changed),
        _ => Err(violation!(UnknownInterface, "SM2-IFC-002")),
    };
    assert_eq!(judged, expected);
    if expected == Ok(Judged::Changed) {
        let stands = [State::Suspended, State::Live][usize::from(is_allowed)];
        assert!(it.state == stands && it.links == before.links);
    } else {
        assert!(it == before);
    }
    kani::cover!(judged == Ok(Judged::Changed) && is_allowed, "allowed again");
}

/// UNLINKED goes out once in a session for each end, whichever side is first, and never after
/// WITHDRAW.
//= SM2-LNK-003, SM2-LNK-009, SM2-IFC-004 kani
// Shows LNK-FAREWELL (Exhaustive), bound: 3 steps from any of 7 states with 2 links.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn one_farewell_of_each_end() {
    let mut it = any_interface();
    let (state, link) = (it.state, LINKS[0]);
    let standing = it.links.get(&link).map(|(standing, _)| *standing);
    let known =
        matches!(state, State::Live | State::Suspended) && standing == Some(Standing::Known);
    let mut said = 0;
    for _ in 0..3 {
        let says = if kani::any() {
            it.close_link(link)
        } else {
            it.unlink(link) == Ok(Answer::Unlinked)
        };
        said += u8::from(says);
    }
    assert_eq!(said, u8::from(known));
    kani::cover!(said == 1, "one farewell");
    kani::cover!(standing == Some(Standing::Left), "said before");
}

/// The program and the session change an interface in this order: declared once, renewed once in
/// each session, claimed once, and removed only after it was withdrawn.
//= SM2-RES-002, SM2-RES-010, SM2-NOD-003, SM2-SES-006 kani
// Shows CLI-SURVIVE (Exhaustive), bound: one step from any of 7 states with 2 links.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn interfaces_outlive_sessions() {
    let mut it = any_interface();
    let before = it.clone();
    let standings = LINKS.map(|link| before.links.get(&link).map(|(standing, _)| *standing));
    match below(6) {
        0 => {
            let sends = it.declare().is_some();
            assert_eq!(sends, before.state == State::Queued);
            assert!(it.declare().is_none(), "declared once");
        }
        1 => {
            let sends = it.renew().is_some();
            assert_eq!(sends, before.state == State::Dormant);
            assert!(it.renew().is_none(), "renewed once");
        }
        2 => {
            let expected = match before.state {
                State::Live | State::Suspended => Ok(Withdrawal::Send),
                State::Renewing => Ok(Withdrawal::Wait),
                State::Queued | State::Dormant => Ok(Withdrawal::Forget),
                State::Declaring | State::WithdrawalQueued | State::Dropping => {
                    Err(Misuse::NotLive)
                }
            };
            assert_eq!(it.withdraw(), expected);
            let gone = expected == Ok(Withdrawal::Forget);
            assert!(
                gone || it.withdraw() == Err(Misuse::NotLive),
                "given up once"
            );
        }
        3 => {
            let given_up = matches!(before.state, State::WithdrawalQueued | State::Dropping);
            let lives = it.away();
            assert_eq!(lives, !given_up);
            if lives {
                assert!(row(it.state) == Row::Unheard);
                for (link, standing) in LINKS.into_iter().zip(standings) {
                    let stays = standing.is_some_and(|it| it != Standing::Left);
                    let now = it.links.get(&link).map(|(standing, _)| *standing);
                    assert!(now == stays.then_some(Standing::Unclaimed));
                }
                kani::cover!(
                    it.links.len() == 2,
                    "its links are claimed from the next Manager"
                );
            }
        }
        4 => {
            let over = it.forget(1).eq(standings[0].map(|_| LINKS[0]));
            assert!(over, "those of this Manager, and no others");
            assert_eq!(it.links.len(), usize::from(standings[1].is_some()));
        }
        _ => {
            let unclaimed = |it: Option<Standing>| it == Some(Standing::Unclaimed);
            let due = standings.into_iter().filter(|it| unclaimed(*it)).count();
            let live = before.state == State::Live;
            assert_eq!(it.claim().count(), if live { due } else { 0 });
            assert_eq!(it.claim().count(), 0, "claimed once");
            kani::cover!(live && due == 2, "two claims");
        }
    }
}

/// LINK is taken exactly with a peer that matches, and with the QoS that both sides ask for; only
/// `sealed` may be more.
//= SM2-LNK-004, SM2-MAT-003, SM2-VER-002 kani
// Shows CLI-STRICT (Exhaustive), bound: none: any terms of a publisher and a subscriber.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn links_have_the_terms_that_were_asked_for() {
    let [offers, seals, demands, demands_seals]: [bool; 4] = kani::any();
    let (other_topic, next_version): (bool, bool) = kani::any();
    let qos = LinkQos {
        reliable: kani::any(),
        sealed: kani::any(),
    };
    let mut it = Interface {
        contract: publisher(offers, seals),
        ..interface(State::Live, [None, None])
    };
    let theirs = if other_topic { "b" } else { "a" };
    let theirs = Name::new(theirs).expect("a legal name");
    let link = Link {
        key: LinkKey(1),
        version: VERSION + u16::from(next_version),
        qos,
    };
    let matches = !other_topic && (offers || !demands);
    let fits = qos.reliable == demands && (qos.sealed || !(seals || demands_seals));
    let expected = if matches && fits && !next_version {
        Ok(true)
    } else {
        Err(violation!(BadLink, "SM2-LNK-004"))
    };
    let peer = subscriber(theirs, demands, demands_seals);
    assert_eq!(it.link(LINKS[0], link, &peer), expected);
    assert_eq!(it.links.len(), usize::from(expected.is_ok()));
    let asked = seals || demands_seals;
    kani::cover!(
        expected.is_ok() && !asked && qos.sealed,
        "sealed by the Manager"
    );
}

#[cfg(test)]
kani::explored! {
    interface_table: 3,
    policies_judge_kept_interfaces: 1,
    one_farewell_of_each_end: 2,
    interfaces_outlive_sessions: 2,
    links_have_the_terms_that_were_asked_for: 1,
}
