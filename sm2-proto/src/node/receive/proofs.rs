//! Harnesses for the Manager's frames: one frame in any phase, with one interface in any state.

use alloc::{string::String, vec::Vec};

use super::{End, Interface, Node, Output, Phase};
use crate::{
    Code, InterfaceId, LinkId, Name, NodeId, Quota, Refusal, TypeId, VERSION, Violation,
    control::{Changes, Page, ReloadOutcome, ToNode},
    node::{
        interface::proofs::{
            any_interface, expected_link, fits, is_declaring, is_unheard, may_be_judged,
        },
        phase::{Interfaces, OpenSession},
    },
    proofs::{below, one_of},
};

/// The interface of the node; number 2 is an interface that it does not have.
const OURS: InterfaceId = InterfaceId(1);

const LINK: LinkId = LinkId {
    epoch: 77,
    serial: 1,
};

/// A node in any phase, with an interface that this phase allows, and with or without open
/// requests.
fn any_node() -> Node {
    let mut node = Node::new(Name::new("n").expect("a legal name"));
    node.outputs.clear();
    let session = OpenSession::new(NodeId(4), 70, Interfaces::new());
    node.phase = one_of(&[
        Phase::Greeting(None),
        Phase::Refused(None),
        Phase::Resuming(session.clone()),
        Phase::Ready(session),
        Phase::Away(End::Eof, None),
        Phase::Ended(End::Eof),
    ]);
    let ended = matches!(node.phase, Phase::Ended(_));
    if !ended && kani::any() {
        let interface = any_interface();
        kani::assume(match node.phase {
            Phase::Resuming(_) => fits(&interface, true),
            Phase::Ready(_) => fits(&interface, false),
            _ => is_unheard(&interface),
        });
        insert(&mut node, interface);
    }
    if let Phase::Resuming(session) = &node.phase {
        // Without a DECLARE to be answered the node would be ready.
        kani::assume(!session.declaring.is_empty());
    }
    if let Phase::Ready(session) | Phase::Resuming(session) = &mut node.phase
        && kani::any()
    {
        session.requests.query();
        assert_eq!(session.requests.watch(), Ok(()));
        session.requests.inspect(NodeId(9));
        session.requests.describe(data());
        let _ = session.requests.reload();
    }
    node
}

/// Gives the node its interface, which implies that it was welcomed.
fn insert(node: &mut Node, interface: Interface) {
    match &mut node.phase {
        Phase::Resuming(session) | Phase::Ready(session) => {
            if is_declaring(&interface) {
                session.declaring.push_back(OURS);
            }
        }
        Phase::Greeting(known) | Phase::Refused(known) | Phase::Away(_, known) => {
            *known = Some(Interfaces::new());
        }
        Phase::Ended(_) => {}
    }
    let interfaces = node.phase.interfaces_mut().expect("it has not ended");
    interfaces.last = OURS;
    interfaces.by_id.insert(OURS, interface);
}

fn data() -> TypeId {
    TypeId {
        name: Name::new("t").expect("a legal name"),
        hash: 1,
    }
}

/// Any frame but LINK, which needs a peer and is proved with the interface.
fn any_frame(interface: InterfaceId) -> ToNode {
    let code = Code(3);
    match below(13) {
        0 => ToNode::Welcome {
            version: one_of(&[VERSION, VERSION + 1, 0]),
            epoch: one_of(&[70, 71]),
            node: NodeId(5),
        },
        1 => ToNode::HelloRefused {
            reason: Refusal::NameTaken,
        },
        2 => ToNode::Declared {
            interface,
            matches: 0,
        },
        3 => ToNode::DeclareRefused {
            interface,
            reason: if kani::any() {
                Refusal::Denied { rule: None }
            } else {
                Refusal::Quota {
                    quota: Quota::InterfacesPerUser,
                    limit: 1,
                }
            },
        },
        4 => ToNode::Unlink {
            interface,
            link: LINK,
            code,
        },
        5 => ToNode::Withdrawn { interface },
        6 => ToNode::Page(Page {
            revision: 1,
            items: Vec::new(),
            next: None,
        }),
        7 => ToNode::Goodbye { code },
        8 => ToNode::Changes(Changes {
            revision: 1,
            changes: None,
            more: false,
        }),
        9 => ToNode::Inspected { node: NodeId(9) },
        10 => ToNode::NotInspected { node: NodeId(8) },
        11 => ToNode::Described {
            data: data(),
            text: kani::any::<bool>().then(String::new),
        },
        _ => ToNode::Reloaded {
            outcome: ReloadOutcome::Applied,
        },
    }
}

const fn unexpected_reloaded() -> Result<(), Violation> {
    Err(violation!(UnexpectedReloaded, "SM2-ACC-016"))
}

/// Whether the frame may tell that a new access policy allows or denies the interface.
fn is_judged(interface: &Interface, frame: &ToNode) -> bool {
    let is_allowed = matches!(frame, ToNode::Declared { .. });
    let is_denial = matches!(frame, ToNode::DeclareRefused { reason, .. } if reason.is_denial());
    may_be_judged(interface, is_allowed, is_denial)
}

/// CLI-PHASE: a frame has the effect that the tables of SPEC sections 4.2 and 4.3 state. A
/// violation ends the session and has no other effect.
//= SM2-NOD-001, SM2-NOD-002, SM2-IFC-002, SM2-IFC-007, SM2-WCH-001, SM2-CNT-003, SM2-SCH-002 kani
//= SM2-FRM-004, SM2-LNK-003, SM2-ACC-016 kani
// Shows CLI-STRICT (Exhaustive), bound: one frame in any phase, with at most one interface in any state and 2 links.
#[cfg_attr(kani, kani::proof)]
// One interface with two links; names of one byte, frames of at most 24.
#[cfg_attr(kani, kani::unwind(26))]
fn session_table() {
    let mut node = any_node();
    let named = one_of(&[OURS, InterfaceId(2)]);
    let frame = any_frame(named);
    let mut before = node.clone();
    let asked = (before.phase.session()).is_some_and(|it| it.requests != Default::default());
    let interfaces = before.phase.interfaces_mut().cloned();
    let interfaces = interfaces.unwrap_or(Interfaces::new());
    let ours = interfaces.by_id.get(&named);
    let is_asked_for = ours.is_some_and(is_declaring);
    let is_judged = ours.is_some_and(|it| is_judged(it, &frame));
    let answers = is_asked_for || is_judged;
    let welcomes = matches!(frame, ToNode::Welcome { .. } | ToNode::HelloRefused { .. });
    let says_goodbye = matches!(frame, ToNode::Goodbye { .. });
    let expected = match (&before.phase, &frame) {
        (Phase::Away(..) | Phase::Ended(_), _) | (_, ToNode::Goodbye { .. }) => Ok(()),
        (Phase::Greeting(_), ToNode::Welcome { version: 1, .. } | ToNode::HelloRefused { .. }) => {
            Ok(())
        }
        (Phase::Greeting(_), ToNode::Welcome { .. }) => Err(violation!(BadVersion, "SM2-NOD-002")),
        (_, _) if welcomes => Err(violation!(UnexpectedWelcome, "SM2-NOD-001")),
        (Phase::Greeting(_) | Phase::Refused(_), _) => {
            Err(violation!(ExpectedWelcome, "SM2-NOD-001"))
        }
        (_, ToNode::Declared { .. } | ToNode::DeclareRefused { .. }) if answers => Ok(()),
        (_, ToNode::Declared { .. } | ToNode::DeclareRefused { .. }) => {
            Err(violation!(UnknownInterface, "SM2-IFC-002"))
        }
        // The interface does not have this link.
        (_, ToNode::Unlink { .. }) => match ours.and_then(expected_link) {
            Some(_) => Err(violation!(UnknownLink, "SM2-LNK-003")),
            None => Err(violation!(UnknownInterface, "SM2-LNK-003")),
        },
        (_, ToNode::Withdrawn { .. }) => match ours.and_then(expected_link) {
            Some(false) => Ok(()),
            _ => Err(violation!(UnknownInterface, "SM2-IFC-003")),
        },
        (_, ToNode::Page(_)) if !asked => Err(violation!(UnexpectedPage, "SM2-IFC-007")),
        (_, ToNode::Changes(_)) if !asked => Err(violation!(UnexpectedChanges, "SM2-WCH-001")),
        (_, ToNode::Inspected { .. }) if asked => Ok(()),
        (_, ToNode::Inspected { .. } | ToNode::NotInspected { .. }) => {
            Err(violation!(UnexpectedCounters, "SM2-CNT-003"))
        }
        (_, ToNode::Described { .. }) if !asked => Err(violation!(UnexpectedSchema, "SM2-SCH-002")),
        (_, ToNode::Described { text: Some(_), .. }) => Err(violation!(BadSchema, "SM2-SCH-002")),
        (_, ToNode::Reloaded { .. }) if !asked => unexpected_reloaded(),
        _ => Ok(()),
    };
    let has_fds = kani::any();
    assert_eq!(node.step(frame, has_fds), expected);
    let is_over = matches!(before.phase, Phase::Away(..) | Phase::Ended(_));
    if expected.is_err() || is_over {
        assert!(node == before, "a violation has no other effect");
    }
    if says_goodbye && !is_over {
        assert!(node.is_away());
        assert!(node.outputs.back() == Some(&Output::Ended(End::Peer(Code(3)))));
    }
    kani::cover!(is_over, "late");
    kani::cover!(
        expected == Err(violation!(UnknownLink, "SM2-LNK-003")),
        "no such link"
    );
    kani::cover!(expected.is_ok() && is_asked_for, "answered");
    kani::cover!(expected.is_ok() && is_judged, "judged by another policy");
    kani::cover!(
        expected.is_ok() && welcomes && node.is_ready() && !interfaces.by_id.is_empty(),
        "welcomed again, and no interface was live"
    );
}

/// CLAIMED goes out when the last renewed DECLARE is answered, once, and not before.
//= SM2-RES-002 kani
// Shows CLI-SURVIVE (Exhaustive), bound: one answer, with at most two renewed interfaces.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(26))]
fn claims_wait_for_all_answers() {
    let mut node = any_node();
    kani::assume(matches!(node.phase, Phase::Resuming(_)));
    let more = kani::any::<bool>();
    if more && let Some(session) = node.phase.session_mut() {
        // Another interface waits for its answer as well.
        session.declaring.push_back(InterfaceId(2));
        let interfaces = &mut session.interfaces.by_id;
        interfaces.insert(InterfaceId(2), interfaces[&OURS].clone());
    }
    let answer = if kani::any() {
        ToNode::Declared {
            interface: OURS,
            matches: 0,
        }
    } else {
        ToNode::DeclareRefused {
            interface: OURS,
            reason: Refusal::NameTaken,
        }
    };
    assert_eq!(node.step(answer, true), Ok(()));
    assert_eq!(node.is_ready(), !more);
    let resumed = node.outputs.iter().filter(|it| **it == Output::Resumed);
    assert_eq!(resumed.count(), usize::from(!more));
    kani::cover!(more, "not yet");
}

#[cfg(test)]
kani::explored! {
    session_table: 5,
    claims_wait_for_all_answers: 1,
}
