//! A node's sessions with Managers that break the rules, and with correct ones.

// Shows CLI-STRICT, CLI-DROPPING (test), bound: a row for each violation.

use crate::frames;

use crate::support::{
    cases,
    contracts::{data, name, publisher_with, subscriber},
    session::{
        EPOCH, NOW, contract, declared, drain, interface_in, link, link_id, page, ready, receive,
        refused, schema, sent, unlink, violation, welcome, withdrawn,
    },
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Code, Contract, Datagram, InterfaceId, Machine, NodeId, Refusal,
    control::{LinkPeer, SchemaText, ToManager, ToNode},
    limits::LINKS_MAX,
    node::{End, Error, Input, Misuse, Node, Output},
    violation,
};

//= SM2-NOD-001 test
#[test]
fn a_violation_is_said_once_and_answers_for_ever() {
    let mut node = ready();
    let end = End::Violation(violation!(UnknownInterface, "SM2-IFC-002"));
    assert_eq!(receive(&mut node, &declared(9)), Err(Error::Ended(end)));
    let outputs = drain(&mut node);
    assert_eq!(sent(&outputs), [ToManager::Goodbye { code: Code(36) }]);
    assert_eq!(outputs.last(), Some(&Output::Ended(end)));
    assert_eq!(node.end(), Some(end));
    let misplaced = |node: &mut Node, end| {
        for input in [
            Input::Eof,
            Input::Greet(name("other")),
            Input::Query { after: None },
            Input::Watch { after: 0 },
            Input::Counters,
            Input::Inspect { node: NodeId(4) },
            Input::Datagram(Datagram::new(&[8, 0])),
        ] {
            assert_eq!(node.handle(NOW, input), Err(Error::Ended(end)));
        }
        assert_eq!(drain(node), []);
        assert_eq!((node.id(), node.epoch()), (None, None));
        assert_eq!(node.deadline(), None);
    };
    misplaced(&mut node, end);
    assert!(node.is_away());
    // Only this node ends the machine itself.
    let local = End::Local(Code(0));
    node.handle(NOW, Input::Close(Code(0))).expect("away");
    assert_eq!(
        drain(&mut node),
        [Output::Ended(local)],
        "nobody is there to hear it"
    );
    misplaced(&mut node, local);
    assert!(!node.is_away());
    for input in [
        Input::Reconnected,
        Input::Close(Code(0)),
        Input::Withdraw {
            interface: InterfaceId(1),
        },
        Input::Unlinked {
            interface: InterfaceId(1),
            link: link_id(1),
            code: Code(0),
        },
    ] {
        assert_eq!(node.handle(NOW, input), Err(Error::Ended(local)));
    }
    assert_eq!(node.declare(contract()), Err(Error::Ended(local)));
    assert_eq!(drain(&mut node), []);
}

//= SM2-NOD-002, SM2-VER-001 test
#[test]
fn welcome_carries_a_version_of_the_range() {
    for version in [0, 2, u16::MAX] {
        let mut node = Node::new(name("lidar"));
        let welcome = ToNode::Welcome {
            version,
            epoch: 1,
            node: NodeId(1),
        };
        assert_eq!(
            violation(&mut node, &welcome),
            violation!(BadVersion, "SM2-NOD-002")
        );
    }
}

//= SM2-SES-001, SM2-SES-003 test
#[test]
fn a_refused_node_greets_again() {
    let mut node = Node::new(name("lidar"));
    let hello = |text| ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: name(text),
        resuming: false,
    };
    assert_eq!(sent(&drain(&mut node)), [hello("lidar")]);
    let again = |node: &mut Node| node.handle(NOW, Input::Greet(name("lidar2")));
    assert_eq!(again(&mut node), Err(Misuse::NotRefused.into()));
    let refusal = ToNode::HelloRefused {
        reason: Refusal::NameTaken,
    };
    receive(&mut node, &refusal).expect("legal");
    assert!(!node.is_ready());
    assert_eq!(again(&mut node), Ok(()));
    assert_eq!(sent(&drain(&mut node)), [hello("lidar2")]);
    receive(&mut node, &welcome()).expect("legal");
    assert_eq!((node.id(), node.epoch()), (Some(NodeId(3)), Some(EPOCH)));
    assert_eq!(again(&mut node), Err(Misuse::NotRefused.into()));
}

//= SM2-IFC-001 test
#[test]
fn interfaces_are_numbered_upwards() {
    let mut node = interface_in("gone");
    let numbers = [1, 2, 3].map(|_| node.declare(contract()).expect("ready").0);
    assert_eq!(numbers, [2, 3, 4]);
    receive(&mut node, &refused(2)).expect("legal");
    assert_eq!(node.declare(contract()), Ok(InterfaceId(5)));
}

//= SM2-IFC-002 test
#[test]
fn declares_are_answered_in_their_order() {
    let mut node = ready();
    node.declare(contract()).expect("ready");
    let unanswered = node.clone();
    assert_eq!(
        violation(&mut node, &declared(3)),
        violation!(UnknownInterface, "SM2-IFC-002")
    );
    let mut node = unanswered;
    receive(&mut node, &refused(2)).expect("the older one first");
    receive(&mut node, &declared(3)).expect("then the younger one");
}

//= SM2-LNK-004, SM2-VER-002 test
#[test]
fn a_link_that_cannot_be() {
    let altered = |alter: &dyn Fn(&mut u16, &mut bool, &mut LinkPeer)| {
        let mut frame = link(1, 2);
        if let ToNode::Link {
            version,
            reliable,
            peer,
            ..
        } = &mut frame
        {
            alter(version, reliable, peer);
        }
        frame
    };
    let frames = [
        altered(&|version, _, _| *version = 0),
        altered(&|version, _, _| *version = 2),
        altered(&|_, reliable, _| *reliable = true),
        altered(&|_, _, peer| peer.contract = contract()),
        altered(&|_, _, peer| peer.contract = subscriber("image", None)),
        altered(&|_, _, peer| peer.contract = subscriber("scan", Some(&data("Image")))),
    ];
    for frame in &frames {
        assert_eq!(
            violation(&mut ready(), frame),
            violation!(BadLink, "SM2-LNK-004")
        );
    }
    assert_eq!(
        violation(&mut ready(), &link(1, 1)),
        violation!(BadLinkId, "SM2-LNK-004")
    );
    // The id is checked before the contents of the link.
    let mut both = frames[0].clone();
    if let ToNode::Link { link, .. } = &mut both {
        *link = link_id(1);
    }
    assert_eq!(
        violation(&mut ready(), &both),
        violation!(BadLinkId, "SM2-LNK-004")
    );
}

//= SM2-MAT-003 test
#[test]
fn the_manager_may_seal_without_a_demand_but_not_unseal() {
    let sealed = |interface, sealed| {
        let mut frame = link(interface, 2);
        if let ToNode::Link { sealed: it, .. } = &mut frame {
            *it = sealed;
        }
        frame
    };
    let mut node = ready();
    receive(&mut node, &sealed(1, true)).expect("the policy may ask for it");
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    let contract = publisher_with("scan", &data("Scan"), true, true);
    node.declare(contract).expect("ready");
    receive(&mut node, &declared(1)).expect("legal");
    assert_eq!(
        violation(&mut node, &sealed(1, false)),
        violation!(BadLink, "SM2-LNK-004")
    );
}

/// Crossing farewells: each end has exactly one in each direction.
//= SM2-LNK-003, SM2-LNK-009 test
#[test]
fn one_farewell_each() {
    let over = |node: &mut Node| {
        node.handle(
            NOW,
            Input::Unlinked {
                interface: InterfaceId(1),
                link: link_id(1),
                code: Code(5),
            },
        )
        .expect("harmless");
        sent(&drain(node))
    };
    let unlinked = ToManager::Unlinked {
        interface: InterfaceId(1),
        link: link_id(1),
        code: Code(5),
    };
    // The node is first. The Manager's own farewell is its answer, or has crossed the node's.
    let mut node = ready();
    assert_eq!(over(&mut node), [unlinked]);
    assert_eq!(over(&mut node), [], "once");
    assert_eq!(receive(&mut node, &unlink(1, 1)), Ok(Vec::new()));
    assert_eq!(over(&mut node), [], "nobody names it again");
    assert_eq!(
        violation(&mut node, &unlink(1, 1)),
        violation!(UnknownLink, "SM2-LNK-003")
    );
    // The Manager is first. The machine of the link ends later.
    let mut node = ready();
    receive(&mut node, &unlink(1, 1)).expect("legal");
    assert_eq!(over(&mut node), []);
    assert_eq!(
        violation(&mut node, &unlink(1, 1)),
        violation!(UnknownLink, "SM2-LNK-003")
    );
}

//= SM2-IFC-004 test
#[test]
fn nothing_is_answered_while_dropping() {
    let mut node = interface_in("dropping");
    node.handle(
        NOW,
        Input::Unlinked {
            interface: InterfaceId(1),
            link: link_id(1),
            code: Code(0),
        },
    )
    .expect("harmless");
    assert_eq!(drain(&mut node), []);
    // A LINK that crossed WITHDRAW, and its UNLINK.
    assert_eq!(receive(&mut node, &link(1, 2)), Ok(Vec::new()));
    assert_eq!(receive(&mut node, &unlink(1, 2)), Ok(Vec::new()));
    assert_eq!(receive(&mut node, &unlink(1, 1)), Ok(Vec::new()));
    let gone = Output::Withdrawn {
        interface: InterfaceId(1),
    };
    assert_eq!(receive(&mut node, &withdrawn(1)), Ok(vec![gone]));
}

/// The number of links that a Manager can make a node keep is limited.
//= SM2-LNK-004 test
#[test]
fn links_of_an_interface_are_bounded() {
    let mut node = interface_in("live");
    for serial in 2..=u64::try_from(LINKS_MAX).expect("small") {
        receive(&mut node, &link(1, serial)).expect("legal");
    }
    let mut full = node.clone();
    assert_eq!(
        violation(&mut full, &link(1, 0)),
        violation!(BadLink, "SM2-LNK-004")
    );
    receive(&mut node, &unlink(1, 1)).expect("legal");
    receive(&mut node, &link(1, 0)).expect("there is room again");
}

//= SM2-FRM-003 test
#[test]
fn misuse_changes_nothing() {
    let mut node = ready();
    let before = node.clone();
    let mut too_deep = contract();
    if let Contract::Publisher { offer, .. } = &mut too_deep {
        offer.depth = 1_025;
    }
    let out_of_range = Misuse::Qos {
        field: "depth",
        value: 1_025,
    };
    assert_eq!(node.declare(too_deep), Err(out_of_range.into()));
    for interface in [0, 2, 9].map(InterfaceId) {
        let withdrawn = node.handle(NOW, Input::Withdraw { interface });
        assert_eq!(withdrawn, Err(Misuse::NotLive.into()), "{interface}");
    }
    assert_eq!(node, before);
    let mut early = Node::new(name("lidar"));
    let before = early.clone();
    assert_eq!(early.declare(contract()), Err(Misuse::NotReady.into()));
    let (data, text) = schema();
    for input in [
        Input::Query { after: None },
        Input::Watch { after: 0 },
        Input::Counters,
        Input::Inspect { node: NodeId(1) },
        Input::Schema(SchemaText {
            data: data.clone(),
            text,
        }),
        Input::Describe { data },
        Input::Withdraw {
            interface: InterfaceId(1),
        },
    ] {
        assert_eq!(early.handle(NOW, input), Err(Misuse::NotReady.into()));
    }
    for mut connected in [early.clone(), node] {
        let again = connected.handle(NOW, Input::Reconnected);
        assert_eq!(again, Err(Misuse::Connected.into()));
    }
    assert_eq!(early, before);
}

//= SM2-COD-001 test
#[test]
fn the_node_hangs_up() {
    let mut node = ready();
    node.handle(NOW, Input::Close(Code(0))).expect("legal");
    let outputs = drain(&mut node);
    assert_eq!(sent(&outputs), [ToManager::Goodbye { code: Code(0) }]);
    assert_eq!(outputs.last(), Some(&Output::Ended(End::Local(Code(0)))));
    // The Manager's goodbye is not answered, whatever its code.
    let mut node = ready();
    let goodbye = ToNode::Goodbye { code: Code(40_000) };
    let ended = Output::Ended(End::Peer(Code(40_000)));
    assert_eq!(receive(&mut node, &goodbye), Ok(vec![ended]));
}

/// Frames that a Manager may or must not send: any frame, or one about the few interfaces and links
/// that the node has.
fn any_frame() -> impl Strategy<Value = ToNode> {
    let few = || 0..4_u64;
    prop_oneof![
        1 => frames::to_node(),
        4 => few().prop_map(declared),
        1 => few().prop_map(refused),
        4 => (few(), few()).prop_map(|(interface, serial)| link(interface, serial)),
        4 => (few(), few()).prop_map(|(interface, serial)| unlink(interface, serial)),
        2 => few().prop_map(withdrawn),
        1 => Just(page()),
        1 => Just(welcome()),
    ]
}

proptest! {
    #![proptest_config(cases(400))]

    /// The node follows SPEC whatever Managers send, and names the reason when it ends a session.
    //= SM2-NOD-001, SM2-LNK-003, SM2-IFC-004 test
    #[test]
    fn hostile_managers(steps in vec((any_frame(), 0..9_u8, 0..4_u64), 1..80)) {
        let mut node = Node::new(name("lidar"));
        let mut session = drain(&mut node);
        for (frame, own, number) in steps {
            let interface = InterfaceId(number);
            let link = link_id(number);
            // Misuse and an end before this are reported; neither matters here.
            let _ = match own {
                0 | 1 => node.declare(contract()).map(drop),
                2 => node.handle(NOW, Input::Withdraw { interface }),
                3 => node.handle(NOW, Input::Unlinked { interface, link, code: Code(0) }),
                4 => node.handle(NOW, Input::Query { after: None }),
                5 => node.handle(NOW, Input::Watch { after: 1 }),
                6 if node.is_away() => {
                    check_session(&node, &session)?;
                    session.clear();
                    node.handle(NOW, Input::Reconnected)
                }
                _ => Ok(()),
            };
            session.extend(drain(&mut node));
            let end = node.end();
            let received = receive(&mut node, &frame);
            match (end, received) {
                (Some(end), received) => prop_assert_eq!(received, Err(Error::Ended(end))),
                (None, Ok(more)) => session.extend(more),
                (None, Err(error)) => prop_assert_eq!(Some(error), node.end().map(Error::Ended)),
            }
            session.extend(drain(&mut node));
        }
        check_session(&node, &session)?;
    }
}

/// The frames that a node may have sent since its greeting, whatever its Manager did.
fn check_session(node: &Node, outputs: &[Output]) -> Result<(), TestCaseError> {
    let ended = outputs.iter().filter(|it| matches!(it, Output::Ended(_)));
    prop_assert_eq!(ended.count(), usize::from(node.end().is_some()));
    let frames = sent(outputs);
    let goodbye = frames
        .iter()
        .position(|it| matches!(it, ToManager::Goodbye { .. }));
    let expected = matches!(node.end(), Some(End::Violation(_)));
    prop_assert_eq!(goodbye.is_some(), expected);
    if let Some(at) = goodbye {
        prop_assert_eq!(at + 1, frames.len(), "the last frame");
    }
    // HELLO comes first, all claims before CLAIMED, and no interface is declared twice.
    let greets = matches!(frames.first(), Some(ToManager::Hello { .. }));
    prop_assert!(greets);
    let claimed = frames
        .iter()
        .position(|it| matches!(it, ToManager::Claimed));
    let claim = frames
        .iter()
        .rposition(|it| matches!(it, ToManager::Claim { .. }));
    prop_assert!(claim.is_none() || claim < claimed);
    let mut declared = 0;
    for frame in &frames {
        if let ToManager::Declare { interface, .. } = frame {
            prop_assert!(interface.0 > declared, "numbers grow (SM2-IFC-001)");
            declared = interface.0;
        }
    }
    // Each end of a link has one farewell, as long as its number is not used again.
    let mut said = Vec::new();
    for output in outputs {
        match output {
            Output::Linked {
                interface, link, ..
            } => said.retain(|it| *it != (*interface, *link)),
            Output::Transmit(_) => {
                let frame = sent(std::slice::from_ref(output)).remove(0);
                if let ToManager::Unlinked {
                    interface, link, ..
                } = frame
                {
                    prop_assert!(!said.contains(&(interface, link)));
                    said.push((interface, link));
                }
            }
            _ => {}
        }
    }
    Ok(())
}
