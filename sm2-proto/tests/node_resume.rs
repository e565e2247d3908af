//! A node whose Manager ends, and the interfaces and links that it claims from the next one (SPEC
//! section 11).

use crate::support::{
    contracts::{name, subscriber},
    session::{
        EPOCH, LATER, NOW, ask, changes, claim, claim_of, come_back, contract, declared, described,
        drain, interface_in, link, link_id, page, ready, receive, refused, reloaded, sent, unlink,
        violation, welcome, welcome_in, withdrawn,
    },
};
use sm2_proto::{
    Code, InterfaceId, LinkId, LinkKey, Machine, NodeId, Refusal,
    control::{ToManager, ToNode},
    node::{End, Input, Misuse, Node, Output},
    violation,
};

fn hello(resuming: bool) -> ToManager {
    ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: name("lidar"),
        resuming,
    }
}

fn declare(interface: u64) -> ToManager {
    ToManager::Declare {
        interface: InterfaceId(interface),
        contract: contract(),
    }
}

fn withdraw(interface: u64) -> ToManager {
    let interface = InterfaceId(interface);
    ToManager::Withdraw { interface }
}

fn is_gone(interface: u64) -> Output {
    let interface = InterfaceId(interface);
    Output::Withdrawn { interface }
}

fn unlinked(interface: u64, link: LinkId) -> Input<'static> {
    Input::Unlinked {
        interface: InterfaceId(interface),
        link,
        code: Code(5),
    }
}

fn give_up(node: &mut Node, interface: u64) -> Vec<Output> {
    let interface = InterfaceId(interface);
    node.handle(NOW, Input::Withdraw { interface })
        .expect("declared");
    drain(node)
}

/// Interfaces 1 to `count` are live, and each has the link of its number.
fn live(count: u64) -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    for number in 1..=count {
        node.declare(contract()).expect("ready");
        receive(&mut node, &declared(number)).expect("legal");
        receive(&mut node, &link(number, number)).expect("legal");
    }
    drain(&mut node);
    node
}

/// The frames that the node sends after this one.
fn answer(node: &mut Node, frame: &ToNode) -> Vec<ToManager> {
    sent(&receive(node, frame).expect("legal"))
}

//= SM2-RES-001, SM2-NOD-003 test
#[test]
fn every_end_but_our_own_leads_away_and_back() {
    let ends: [fn(&mut Node); 3] = [
        |node| node.handle(NOW, Input::Eof).expect("a session"),
        |node| {
            let goodbye = ToNode::Goodbye { code: Code(3) };
            node.handle(NOW, Input::Counters).expect("ready");
            receive(node, &goodbye).expect("legal");
        },
        |node| {
            assert_eq!(
                violation(node, &declared(9)),
                violation!(UnknownInterface, "SM2-IFC-002")
            )
        },
    ];
    for end in ends {
        let mut node = live(1);
        end(&mut node);
        assert!(node.is_away() && node.end().is_some() && !node.is_ready());
        assert_eq!((node.id(), node.epoch()), (None, None));
        drain(&mut node);
        node.handle(NOW, Input::Reconnected).expect("away");
        assert!(!node.is_away() && node.end().is_none());
        assert_eq!(sent(&drain(&mut node)), [hello(true)]);
        assert_eq!(answer(&mut node, &welcome_in(LATER)), [declare(1)]);
        assert!(!node.is_ready() && node.epoch() == Some(LATER));
        let outputs = receive(&mut node, &declared(1)).expect("legal");
        assert_eq!(sent(&outputs), [claim(1), ToManager::Claimed]);
        assert_eq!(outputs.last(), Some(&Output::Resumed));
        assert!(node.is_ready());
    }
}

//= SM2-RES-001 test
#[test]
fn a_node_that_was_never_welcomed_resumes_nothing() {
    let mut node = Node::new(name("lidar"));
    assert_eq!(sent(&drain(&mut node)), [hello(false)]);
    node.handle(NOW, Input::Eof).expect("a session");
    assert_eq!(drain(&mut node), [Output::Ended(End::Eof)]);
    assert_eq!(node.declare(contract()), Err(Misuse::NotReady.into()));
    assert!(!node.was_welcomed());
    node.handle(NOW, Input::Reconnected).expect("away");
    assert_eq!(sent(&drain(&mut node)), [hello(false)]);
    let outputs = receive(&mut node, &welcome()).expect("legal");
    assert!(matches!(
        &outputs[..],
        [Output::Welcomed {
            resuming: false,
            ..
        }]
    ));
    assert!(node.is_ready() && node.was_welcomed());
}

//= SM2-RES-002 test
#[test]
fn a_node_with_nothing_to_resume_says_so() {
    let mut node = live(0);
    let outputs = come_back(&mut node);
    assert_eq!(sent(&outputs), [ToManager::Claimed]);
    assert!(matches!(
        &outputs[..],
        [
            Output::Welcomed {
                epoch: LATER,
                resuming: true,
                ..
            },
            Output::Transmit(_),
            Output::Resumed
        ]
    ));
}

/// One interface is live, one is withdrawn before its answer, one has an unanswered WITHDRAW, and
/// one is declared and not answered. With the next Manager, each reaches the intended state.
//= SM2-RES-002, SM2-RES-010, SM2-SES-006 test
#[test]
fn what_was_on_its_way_when_the_manager_ended() {
    let mut node = live(4);
    receive(&mut node, &link(4, 14)).expect("legal");
    node.declare(contract()).expect("ready");
    node.handle(NOW, unlinked(4, link_id(4))).expect("live");
    give_up(&mut node, 2);
    drain(&mut node);
    node.handle(NOW, Input::Eof).expect("a session");
    let outputs = drain(&mut node);
    assert_eq!(outputs, [is_gone(2), Output::Ended(End::Eof)]);

    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    let again = answer(&mut node, &welcome_in(LATER));
    assert_eq!(again, [declare(1), declare(3), declare(4)]);
    assert_eq!(answer(&mut node, &declared(1)), []);
    let outputs = receive(&mut node, &refused(3)).expect("legal");
    assert!(matches!(
        &outputs[..],
        [Output::DeclareRefused {
            interface: InterfaceId(3),
            ..
        }]
    ));
    // Link 4 of interface 4 was over before.
    let claims = [claim(1), claim_of(4, 14), ToManager::Claimed, declare(5)];
    assert_eq!(answer(&mut node, &declared(4)), claims);
    // The program is told about the interface that was never answered.
    let outputs = receive(&mut node, &declared(5)).expect("legal");
    assert!(matches!(&outputs[..], [Output::Declared { .. }]));

    // The refused interface has kept its link, and is declared again with the next Manager.
    let mut later = node.clone();
    node.handle(NOW, Input::Eof).expect("a session");
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    let again = answer(&mut node, &welcome_in(LATER + 1));
    assert_eq!(again, [1, 3, 4, 5].map(declare));
    for number in [1, 3, 4] {
        assert_eq!(answer(&mut node, &declared(number)), []);
    }
    let claims = [
        claim(1),
        claim_of(3, 3),
        claim_of(4, 14),
        ToManager::Claimed,
    ];
    assert_eq!(answer(&mut node, &declared(5)), claims);
    // An interface that was withdrawn is not withdrawn from a Manager that does not know it.
    later.handle(NOW, unlinked(3, link_id(3))).expect("ready");
    assert_eq!(drain(&mut later), []);
    assert_eq!(give_up(&mut later, 3), [is_gone(3)]);
    let unknown = violation(&mut later, &withdrawn(3));
    assert_eq!(unknown, violation!(UnknownInterface, "SM2-IFC-003"));
}

//= SM2-RES-002, SM2-NOD-003 test
#[test]
fn away_links_end_and_interfaces_come_and_go() {
    let mut node = live(3);
    node.handle(NOW, Input::Eof).expect("a session");
    drain(&mut node);
    node.handle(NOW, unlinked(1, link_id(1))).expect("away");
    node.handle(NOW, unlinked(1, link_id(9))).expect("harmless");
    assert_eq!(node.declare(contract()), Ok(InterfaceId(4)));
    assert_eq!(node.declare(contract()), Ok(InterfaceId(5)));
    assert_eq!(drain(&mut node), [], "nobody is there to be told");
    assert_eq!(give_up(&mut node, 2), [is_gone(2)]);
    assert_eq!(give_up(&mut node, 4), [is_gone(4)]);
    let twice = Input::Withdraw {
        interface: InterfaceId(2),
    };
    assert_eq!(node.handle(NOW, twice), Err(Misuse::NotLive.into()));
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    // The same while the node greets.
    assert_eq!(node.declare(contract()), Ok(InterfaceId(6)));
    assert_eq!(give_up(&mut node, 5), [is_gone(5)]);
    assert_eq!(
        answer(&mut node, &welcome_in(LATER)),
        [declare(1), declare(3)]
    );
    assert_eq!(node.declare(contract()), Ok(InterfaceId(7)));
    assert_eq!(drain(&mut node), [], "it waits for CLAIMED");
    assert_eq!(answer(&mut node, &declared(1)), []);
    let claims = [claim_of(3, 3), ToManager::Claimed, declare(6), declare(7)];
    assert_eq!(answer(&mut node, &declared(3)), claims);
}

//= SM2-RES-002, SM2-IFC-003 test
#[test]
fn withdrawn_between_welcome_and_claimed() {
    let mut node = live(4);
    come_back(&mut node);
    receive(&mut node, &declared(1)).expect("legal");
    // An interface that is granted is withdrawn at once, the others when they are answered.
    assert_eq!(sent(&give_up(&mut node, 1)), [withdraw(1)]);
    assert_eq!(give_up(&mut node, 2), []);
    assert_eq!(give_up(&mut node, 3), []);
    for twice in [1, 2, 3].map(InterfaceId) {
        let twice = node.handle(NOW, Input::Withdraw { interface: twice });
        assert_eq!(twice, Err(Misuse::NotLive.into()));
    }
    assert_eq!(answer(&mut node, &declared(2)), [withdraw(2)]);
    assert_eq!(receive(&mut node, &refused(3)), Ok(vec![is_gone(3)]));
    assert_eq!(receive(&mut node, &withdrawn(1)), Ok(vec![is_gone(1)]));
    node.handle(NOW, unlinked(4, link_id(4))).expect("resuming");
    assert_eq!(answer(&mut node, &declared(4)), [ToManager::Claimed]);
    assert_eq!(receive(&mut node, &withdrawn(2)), Ok(vec![is_gone(2)]));
}

//= SM2-RES-002, SM2-RES-006 test
#[test]
fn a_claimed_link_is_a_link_like_any_other() {
    let farewell = [ToManager::Unlinked {
        interface: InterfaceId(1),
        link: link_id(1),
        code: Code(5),
    }];
    // The Manager ends the link,
    let mut node = interface_in("claimed");
    assert_eq!(answer(&mut node, &unlink(1, 1)), farewell);
    // or this node does,
    let mut node = interface_in("claimed");
    node.handle(NOW, unlinked(1, link_id(1))).expect("ready");
    assert_eq!(sent(&drain(&mut node)), farewell);
    assert_eq!(receive(&mut node, &unlink(1, 1)), Ok(Vec::new()));
    // and no second link has the same number.
    let mut node = interface_in("claimed");
    assert_eq!(
        violation(&mut node, &link(1, 1)),
        violation!(BadLinkId, "SM2-LNK-004")
    );
}

//= SM2-RES-002, SM2-SES-006 test
#[test]
fn the_same_manager_ended_its_own_links() {
    let mut node = live(2);
    receive(&mut node, &{
        let mut frame = link(1, 7);
        if let ToNode::Link { link, .. } = &mut frame {
            link.epoch = LATER;
        }
        frame
    })
    .expect("legal");
    node.handle(NOW, Input::Eof).expect("a session");
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    let outputs = receive(&mut node, &welcome_in(EPOCH)).expect("legal");
    let over = |number| Output::Unlink {
        interface: InterfaceId(number),
        link: link_id(number),
        code: Code(0),
    };
    assert_eq!([&outputs[1], &outputs[2]], [&over(1), &over(2)]);
    assert_eq!(sent(&outputs), [declare(1), declare(2)]);
    receive(&mut node, &declared(1)).expect("legal");
    let other = ToManager::Claim {
        interface: InterfaceId(1),
        link: LinkId {
            epoch: LATER,
            serial: 7,
        },
        key: LinkKey(7),
        version: 1,
        reliable: false,
        sealed: false,
    };
    assert_eq!(answer(&mut node, &declared(2)), [other, ToManager::Claimed]);
}

//= SM2-RES-001 test
#[test]
fn a_refused_greeting_is_no_end() {
    let mut node = live(1);
    node.handle(NOW, Input::Eof).expect("a session");
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    let refusal = ToNode::HelloRefused {
        reason: Refusal::NameTaken,
    };
    let outputs = receive(&mut node, &refusal).expect("legal");
    assert_eq!(outputs, [Output::HelloRefused(Refusal::NameTaken)]);
    let other = node.handle(NOW, Input::Greet(name("lidar2")));
    assert_eq!(other, Err(Misuse::OtherName.into()));
    let ways: [fn(&mut Node); 3] = [
        |node| node.handle(NOW, Input::Greet(name("lidar"))).expect("ours"),
        |node| node.handle(NOW, Input::Reconnected).expect("refused"),
        |node| {
            node.handle(NOW, Input::Eof).expect("a session");
            assert_eq!(drain(node), [Output::Ended(End::Eof)]);
            node.handle(NOW, Input::Reconnected).expect("away");
        },
    ];
    for way in ways {
        let mut node = node.clone();
        way(&mut node);
        assert_eq!(sent(&drain(&mut node)), [hello(true)]);
        receive(&mut node, &welcome_in(LATER)).expect("legal");
        let claims = [claim(1), ToManager::Claimed];
        assert_eq!(answer(&mut node, &declared(1)), claims);
    }
}

/// All requests are forgotten with the session: an answer in the next session is a violation.
//= SM2-WCH-001, SM2-CNT-003, SM2-SCH-002, SM2-IFC-007, SM2-IFC-002 test
#[test]
fn no_question_outlives_its_session() {
    let mut node = ready();
    come_back(&mut node);
    receive(&mut node, &declared(1)).expect("legal");
    let inspected = ToNode::Inspected { node: NodeId(4) };
    for (frame, expected) in [
        (page(), violation!(UnexpectedPage, "SM2-IFC-007")),
        (changes(), violation!(UnexpectedChanges, "SM2-WCH-001")),
        (inspected, violation!(UnexpectedCounters, "SM2-CNT-003")),
        (described(), violation!(UnexpectedSchema, "SM2-SCH-002")),
        (reloaded(), violation!(UnexpectedReloaded, "SM2-ACC-016")),
        (declared(1), violation!(UnknownInterface, "SM2-IFC-002")),
    ] {
        assert_eq!(violation(&mut node.clone(), &frame), expected);
    }
    ask(&mut node);
}

/// The Manager dies after any part of the exchange, and the next one gets the whole exchange.
//= SM2-RES-001, SM2-RES-002, SM2-RES-010 test
#[test]
fn a_manager_that_dies_in_the_middle_of_resumption() {
    let exchange = [
        welcome_in(LATER),
        declared(1),
        refused(2),
        declared(3),
        declared(4),
        link(4, 40),
    ];
    for heard in 0..=exchange.len() {
        let mut node = live(3);
        node.declare(contract()).expect("ready");
        node.handle(NOW, Input::Eof).expect("a session");
        node.handle(NOW, Input::Reconnected).expect("away");
        drain(&mut node);
        for frame in &exchange[..heard] {
            receive(&mut node, frame).expect("legal");
        }
        node.handle(NOW, Input::Eof).expect("a session");
        node.handle(NOW, Input::Reconnected).expect("away");
        assert_eq!(sent(&drain(&mut node)), [hello(true)]);
        // Interface 4 counts as declared once DECLARED has come, link 40 once LINK has come.
        let answered = heard > 4;
        let last = if answered { 4 } else { 3 };
        let mut again = answer(&mut node, &welcome_in(LATER + 1));
        for number in 1..=last {
            again.extend(answer(&mut node, &declared(number)));
        }
        let mut expected: Vec<_> = (1..=last).map(declare).collect();
        expected.extend([1, 2, 3].map(|number| claim_of(number, number)));
        expected.extend((heard > 5).then(|| claim_of(4, 40)));
        expected.push(ToManager::Claimed);
        expected.extend((!answered).then(|| declare(4)));
        assert_eq!(again, expected, "after {heard} frames");
        assert!(node.is_ready());
    }
}

/// The contract that was declared is declared again.
//= SM2-RES-002 test
#[test]
fn contracts_are_kept() {
    let mut node = live(0);
    let odd = subscriber("odd/name", None);
    node.declare(odd.clone()).expect("ready");
    receive(&mut node, &declared(1)).expect("legal");
    let again = ToManager::Declare {
        interface: InterfaceId(1),
        contract: odd,
    };
    assert_eq!(sent(&come_back(&mut node)), [again]);
}
