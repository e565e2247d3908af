//! SPEC 4.2 and 4.3, cell by cell, as the node sees its Manager.

mod support;

use sm2_proto::{
    Code, Contract, Datagram, FdFacts, Instant, InterfaceId, LinkId, NodeId, Refusal, Violation,
    control::{Peer, ToManager, ToNode, decode_to_manager, encode_to_node},
    limits::LINKS_MAX,
    node::{End, Error, Input, Misuse, Node, Output},
};
use support::contracts::{data, name, publisher, publisher_with, subscriber};

const NOW: Instant = Instant(0);
const EPOCH: u64 = 5;

const SESSION: &str = "
    -         Welcome             HelloRefused        Declared          DeclareRefused    Link              Unlink            Withdrawn         Page              Goodbye  Eof
    greeting  ready               refused             expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome  ended    ended
    refused   unexpected-welcome  unexpected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome  ended    ended
    ready     unexpected-welcome  unexpected-welcome  ok                ok                ok                ok                ok                ok                ended    ended
    ended     ended               ended               ended             ended             ended             ended             ended             ended             ended    ended
";

/// *Own* names a link that the interface has, *Other* one that it has not.
const INTERFACE: &str = "
    -          Declared           DeclareRefused     Link               UnlinkOwn          UnlinkOther        Withdrawn
    declaring  live               gone               unknown-interface  unknown-interface  unknown-interface  unknown-interface
    live       unknown-interface  unknown-interface  linked             unlinked           unknown-link       unknown-interface
    dropping   unknown-interface  unknown-interface  silent             silent             unknown-link       gone
    gone       unknown-interface  unknown-interface  unknown-interface  unknown-interface  unknown-interface  unknown-interface
";

fn table(text: &str) -> impl Iterator<Item = (&str, &str, &str)> {
    let mut rows = text.lines().filter(|row| !row.trim().is_empty());
    let columns = rows.next().expect("a head").split_whitespace().skip(1);
    rows.flat_map(move |row| {
        let mut cells = row.split_whitespace();
        let state = cells.next().expect("a state");
        let columns = columns.clone();
        columns
            .zip(cells)
            .map(move |(frame, cell)| (state, frame, cell))
    })
}

fn receive(node: &mut Node, frame: &ToNode) -> Result<Vec<Output>, Error> {
    let bytes = encode_to_node(frame);
    let fds = [FdFacts::default()];
    let datagram = Datagram {
        fds: if matches!(frame, ToNode::Link { .. }) {
            &fds
        } else {
            &[]
        },
        ..Datagram::new(&bytes)
    };
    node.handle(NOW, Input::Datagram(datagram))?;
    Ok(drain(node))
}

fn drain(node: &mut Node) -> Vec<Output> {
    std::iter::from_fn(|| node.poll()).collect()
}

fn sent(outputs: &[Output]) -> Vec<ToManager> {
    let frames = outputs.iter().filter_map(|output| match output {
        Output::Transmit(bytes) => Some(bytes),
        _ => None,
    });
    let read = |bytes: &Vec<u8>| decode_to_manager(&Datagram::new(bytes));
    frames
        .map(|bytes| read(bytes).expect("a node sends what a Manager accepts"))
        .collect()
}

fn contract() -> Contract {
    publisher("scan", &data("Scan"))
}

fn link_id(serial: u64) -> LinkId {
    LinkId {
        epoch: EPOCH,
        serial,
    }
}

fn welcome() -> ToNode {
    ToNode::Welcome {
        version: 1,
        epoch: EPOCH,
        node: NodeId(3),
    }
}

fn declared(interface: u64) -> ToNode {
    ToNode::Declared {
        interface: InterfaceId(interface),
        matches: 0,
    }
}

fn link(interface: u64, serial: u64) -> ToNode {
    ToNode::Link {
        interface: InterfaceId(interface),
        link: link_id(serial),
        version: 1,
        reliable: false,
        sealed: false,
        peer: Peer {
            node: NodeId(9),
            name: name("planner"),
            interface: InterfaceId(1),
            contract: subscriber("scan", None),
        },
    }
}

fn unlink(interface: u64, serial: u64) -> ToNode {
    ToNode::Unlink {
        interface: InterfaceId(interface),
        link: link_id(serial),
        code: Code(5),
    }
}

fn withdrawn(interface: u64) -> ToNode {
    let interface = InterfaceId(interface);
    ToNode::Withdrawn { interface }
}

fn page() -> ToNode {
    ToNode::Page {
        revision: 1,
        items: Vec::new(),
        next: None,
    }
}

fn refused(interface: u64) -> ToNode {
    ToNode::DeclareRefused {
        interface: InterfaceId(interface),
        reason: Refusal::TopicType {
            theirs: data("Image"),
        },
    }
}

/// A ready node with interface 1 *live* with link 1, 2 *declaring*, and a query open.
fn ready() -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    node.declare(contract()).expect("ready");
    receive(&mut node, &declared(1)).expect("legal");
    receive(&mut node, &link(1, 1)).expect("legal");
    node.declare(contract()).expect("ready");
    node.handle(NOW, Input::Query { after: None })
        .expect("ready");
    drain(&mut node);
    node
}

fn session_in(state: &str) -> Node {
    let mut node = Node::new(name("lidar"));
    let refusal = ToNode::HelloRefused {
        reason: Refusal::NameTaken,
    };
    match state {
        "greeting" => {}
        "refused" => drop(receive(&mut node, &refusal).expect("legal")),
        "ready" => node = ready(),
        "ended" => node.handle(NOW, Input::Eof).expect("legal"),
        other => panic!("{other} is no state"),
    }
    drain(&mut node);
    node
}

//= SM2-NOD-001, SM2-SES-003 test
#[test]
fn every_state_of_the_session_and_frame() {
    for (state, frame, cell) in table(SESSION) {
        let mut node = session_in(state);
        let result = match frame {
            "Welcome" => receive(&mut node, &welcome()),
            "HelloRefused" => receive(
                &mut node,
                &ToNode::HelloRefused {
                    reason: Refusal::NameTaken,
                },
            ),
            "Declared" => receive(&mut node, &declared(2)),
            "DeclareRefused" => receive(&mut node, &refused(2)),
            "Link" => receive(&mut node, &link(1, 2)),
            "Unlink" => receive(&mut node, &unlink(1, 1)),
            "Withdrawn" => {
                let interface = InterfaceId(1);
                // Only a node that is ready can have asked for it.
                let _ = node.handle(NOW, Input::Withdraw { interface });
                drain(&mut node);
                receive(&mut node, &withdrawn(1))
            }
            "Page" => receive(&mut node, &page()),
            "Goodbye" => receive(&mut node, &ToNode::Goodbye { code: Code(3) }),
            "Eof" => node.handle(NOW, Input::Eof).map(|()| drain(&mut node)),
            other => panic!("{other} is no frame"),
        };
        let actual = match (&result, node.end()) {
            (Err(Error::Ended(End::Violation(violation))), _) => violation.name(),
            (_, Some(_)) => "ended",
            (Ok(outputs), None) if matches!(outputs[..], [Output::HelloRefused(_)]) => "refused",
            (Ok(outputs), None) if matches!(outputs[..], [Output::Welcomed { .. }]) => "ready",
            (Ok(_), None) => "ok",
            (Err(error), None) => panic!("{state} {frame}: {error}"),
        };
        assert_eq!(actual, cell, "{state} {frame}");
    }
}

//= SM2-NOD-001 test
#[test]
fn a_violation_is_said_once_and_answers_for_ever() {
    let mut node = ready();
    let end = End::Violation(Violation::UnknownInterface);
    assert_eq!(receive(&mut node, &declared(9)), Err(Error::Ended(end)));
    let outputs = drain(&mut node);
    assert_eq!(sent(&outputs), [ToManager::Goodbye { code: Code(36) }]);
    assert_eq!(outputs.last(), Some(&Output::Ended(end)));
    assert_eq!(node.end(), Some(end));
    for input in [
        Input::Eof,
        Input::Greet(name("other")),
        Input::Query { after: None },
        Input::Close(Code(0)),
        Input::Datagram(Datagram::new(&[8, 0])),
    ] {
        assert_eq!(node.handle(NOW, input), Err(Error::Ended(end)));
    }
    assert_eq!(node.declare(contract()), Err(Error::Ended(end)));
    assert_eq!(drain(&mut node), []);
    assert_eq!((node.id(), node.epoch()), (None, None));
    assert_eq!(node.deadline(), None);
}

/// Interface 1 in some state, with link 1 where it can have one.
fn interface_in(state: &str) -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    let interface = node.declare(contract()).expect("ready");
    if state != "declaring" {
        receive(&mut node, &declared(1)).expect("legal");
        receive(&mut node, &link(1, 1)).expect("legal");
    }
    if state == "dropping" || state == "gone" {
        node.handle(NOW, Input::Withdraw { interface })
            .expect("live");
    }
    if state == "gone" {
        receive(&mut node, &withdrawn(1)).expect("legal");
    }
    drain(&mut node);
    node
}

//= SM2-IFC-002, SM2-IFC-003, SM2-IFC-004, SM2-FRM-004, SM2-LNK-003, SM2-LNK-005 test
#[test]
fn every_state_of_an_interface_and_frame() {
    for (state, frame, cell) in table(INTERFACE) {
        let mut node = interface_in(state);
        let frame_sent = match frame {
            "Declared" => declared(1),
            "DeclareRefused" => refused(1),
            "Link" => link(1, 2),
            "UnlinkOwn" => unlink(1, 1),
            "UnlinkOther" => unlink(1, 7),
            "Withdrawn" => withdrawn(1),
            other => panic!("{other} is no frame"),
        };
        let actual = match receive(&mut node, &frame_sent) {
            Err(Error::Ended(End::Violation(violation))) => violation.name(),
            Err(error) => panic!("{state} {frame}: {error}"),
            Ok(outputs) => match &outputs[..] {
                [] => "silent",
                [Output::Declared { .. }] => "live",
                [Output::DeclareRefused { .. } | Output::Withdrawn { .. }] => "gone",
                [Output::Linked { .. }] => "linked",
                [Output::Transmit(_), Output::Unlink { .. }] => {
                    let answer = ToManager::Unlinked {
                        interface: InterfaceId(1),
                        link: link_id(1),
                        code: Code(5),
                    };
                    assert_eq!(sent(&outputs), [answer]);
                    "unlinked"
                }
                other => panic!("{state} {frame}: {other:?}"),
            },
        };
        assert_eq!(actual, cell, "{state} {frame}");
    }
}

fn violation(node: &mut Node, frame: &ToNode) -> Violation {
    match receive(node, frame) {
        Err(Error::Ended(End::Violation(violation))) => violation,
        other => panic!("{frame:?} is no violation: {other:?}"),
    }
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
        assert_eq!(violation(&mut node, &welcome), Violation::BadVersion);
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
        Violation::UnknownInterface
    );
    let mut node = unanswered;
    receive(&mut node, &refused(2)).expect("the older one first");
    receive(&mut node, &declared(3)).expect("then the younger one");
}

//= SM2-LNK-005, SM2-VER-002 test
#[test]
fn a_link_that_cannot_be() {
    let altered = |alter: &dyn Fn(&mut u16, &mut bool, &mut Peer)| {
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
        assert_eq!(violation(&mut ready(), frame), Violation::BadLink);
    }
    assert_eq!(violation(&mut ready(), &link(1, 1)), Violation::LinkNumber);
    // The id is judged before what the link is.
    let mut both = frames[0].clone();
    if let ToNode::Link { link, .. } = &mut both {
        *link = link_id(1);
    }
    assert_eq!(violation(&mut ready(), &both), Violation::LinkNumber);
}

//= SM2-MAT-003 test
#[test]
fn the_manager_may_seal_what_nobody_asked_to_but_not_unseal() {
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
    assert_eq!(violation(&mut node, &sealed(1, false)), Violation::BadLink);
}

/// Crossing farewells: each end has exactly one in each direction.
//= SM2-LNK-003, SM2-LNK-004 test
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
    // The node is first; the Manager's own farewell is the answer, or crossed it.
    let mut node = ready();
    assert_eq!(over(&mut node), [unlinked]);
    assert_eq!(over(&mut node), [], "once");
    assert_eq!(receive(&mut node, &unlink(1, 1)), Ok(Vec::new()));
    assert_eq!(over(&mut node), [], "nobody names it again");
    assert_eq!(violation(&mut node, &unlink(1, 1)), Violation::UnknownLink);
    // The Manager is first; the machine of the link ends later.
    let mut node = ready();
    receive(&mut node, &unlink(1, 1)).expect("legal");
    assert_eq!(over(&mut node), []);
    assert_eq!(violation(&mut node, &unlink(1, 1)), Violation::UnknownLink);
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

//= SM2-IFC-007 test
#[test]
fn one_page_for_each_query() {
    let mut node = ready();
    node.handle(NOW, Input::Query { after: None })
        .expect("ready");
    drain(&mut node);
    for _ in 0..2 {
        assert!(matches!(
            receive(&mut node, &page()).as_deref(),
            Ok([Output::Page { .. }])
        ));
    }
    assert_eq!(violation(&mut node, &page()), Violation::UnexpectedPage);
}

/// A Manager cannot make a node keep more than this.
//= SM2-LNK-005 test
#[test]
fn links_of_an_interface_are_bounded() {
    let mut node = interface_in("live");
    for serial in 2..=u64::try_from(LINKS_MAX).expect("small") {
        receive(&mut node, &link(1, serial)).expect("legal");
    }
    let mut full = node.clone();
    assert_eq!(violation(&mut full, &link(1, 0)), Violation::BadLink);
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
    for input in [
        Input::Query { after: None },
        Input::Withdraw {
            interface: InterfaceId(1),
        },
    ] {
        assert_eq!(early.handle(NOW, input), Err(Misuse::NotReady.into()));
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
