//! SPEC sections 4.2, 4.3 and 11, cell by cell, from the node's side.

// Shows CLI-STRICT (test), bound: the whole table.

use crate::support::{
    bench::{suspended, unlinked},
    contracts::name,
    session::{
        NOW, ask, changes, claim, come_back, declared, denied, described, drain, interface_in,
        link, link_id, page, ready, receive, refused, reloaded, sent, unlink, welcome, withdrawn,
    },
};
use sm2_proto::{
    Code, Farewell, InterfaceId, Machine, NodeId, Refusal,
    control::{ToManager, ToNode},
    node::{End, Error, Input, Node, Output},
};

const SESSION: &str = "
    -         Welcome             HelloRefused        Declared          DeclareRefused    Link
    greeting  ready               refused             expected-welcome  expected-welcome  expected-welcome
    refused   unexpected-welcome  unexpected-welcome  expected-welcome  expected-welcome  expected-welcome
    ready     unexpected-welcome  unexpected-welcome  ok                ok                ok
    away      away                away                away              away              away
    back      resuming            refused             expected-welcome  expected-welcome  expected-welcome
    denied    unexpected-welcome  unexpected-welcome  expected-welcome  expected-welcome  expected-welcome
    resuming  unexpected-welcome  unexpected-welcome  ok                ok                unknown-interface
    ended     ended               ended               ended             ended             ended

    -         Unlink            Withdrawn         Page              Changes           Inspected
    greeting  expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome
    refused   expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome
    ready     ok                ok                ok                ok                ok
    away      away              away              away              away              away
    back      expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome
    denied    expected-welcome  expected-welcome  expected-welcome  expected-welcome  expected-welcome
    resuming  unknown-link      ok                ok                ok                ok
    ended     ended             ended             ended             ended             ended

    -         NotInspected      Described         CountersLost      Reloaded          Goodbye  Eof
    greeting  expected-welcome  expected-welcome  expected-welcome  expected-welcome  away     away
    refused   expected-welcome  expected-welcome  expected-welcome  expected-welcome  away     away
    ready     ok                ok                ok                ok                away     away
    away      away              away              away              away              away     away
    back      expected-welcome  expected-welcome  expected-welcome  expected-welcome  away     away
    denied    expected-welcome  expected-welcome  expected-welcome  expected-welcome  away     away
    resuming  ok                ok                ok                ok                away     away
    ended     ended             ended             ended             ended             ended    ended
";

/// *Own* names a link that the interface has, *Other* one that it does not have.
const INTERFACE: &str = "
    -          Declared           DeclareRefused     DeclareDenied      Link
    declaring  live               gone               gone               unknown-interface
    live       unknown-interface  unknown-interface  suspended          linked
    suspended  live               suspended          suspended          unknown-interface
    dropping   silent             silent             silent             silent
    gone       unknown-interface  unknown-interface  unknown-interface  unknown-interface
    renewing   claimed            kept               left               unknown-interface
    doomed     withdrawing        forgotten          withdrawing        unknown-interface
    dormant    unknown-interface  unknown-interface  unknown-interface  unknown-interface
    unclaimed  unknown-interface  unknown-interface  left               unknown-interface
    claimed    unknown-interface  unknown-interface  suspended          linked

    -          UnlinkOwn          UnlinkOther        Withdrawn
    declaring  unknown-interface  unknown-interface  unknown-interface
    live       unlinked           unknown-link       unknown-interface
    suspended  unlinked           unknown-link       unknown-interface
    dropping   silent             unknown-link       gone
    gone       unknown-interface  unknown-interface  unknown-interface
    renewing   unknown-interface  unknown-interface  unknown-interface
    doomed     unknown-interface  unknown-interface  unknown-interface
    dormant    unknown-interface  unknown-interface  unknown-interface
    unclaimed  unknown-link       unknown-link       unknown-interface
    claimed    unlinked           unknown-link       unknown-interface
";

/// The state, the frame and the text of each cell. A table has several blocks of columns, and the
/// first row of a block names its columns.
fn table(text: &str) -> impl Iterator<Item = (&str, &str, &str)> {
    text.split("\n\n").flat_map(block)
}

fn block(text: &str) -> impl Iterator<Item = (&str, &str, &str)> {
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

fn session_in(state: &str) -> Node {
    let mut node = Node::new(name("lidar"));
    let refusal = ToNode::HelloRefused {
        reason: Refusal::NameTaken,
    };
    match state {
        "greeting" => {}
        "refused" => drop(receive(&mut node, &refusal).expect("legal")),
        "ready" => node = ready(),
        "away" => node.handle(NOW, Input::Eof).expect("legal"),
        "back" | "denied" => {
            node = ready();
            node.handle(NOW, Input::Eof).expect("legal");
            node.handle(NOW, Input::Reconnected).expect("away");
            drain(&mut node);
            if state == "denied" {
                receive(&mut node, &refusal).expect("legal");
            }
        }
        // Interface 1 is live, 2 is declared again.
        "resuming" => {
            node = ready();
            receive(&mut node, &declared(2)).expect("legal");
            come_back(&mut node);
            receive(&mut node, &declared(1)).expect("legal");
            ask(&mut node);
        }
        "ended" => node.handle(NOW, Input::Close(Code(0))).expect("legal"),
        other => panic!("{other} is not a state"),
    }
    drain(&mut node);
    node
}

//= SM2-NOD-001, SM2-SES-003, SM2-RES-002, SM2-NOD-003 test
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
                // Only a ready node can have requested the answer.
                let _ = node.handle(NOW, Input::Withdraw { interface });
                drain(&mut node);
                receive(&mut node, &withdrawn(1))
            }
            "Page" => receive(&mut node, &page()),
            "Changes" => receive(&mut node, &changes()),
            "Inspected" => receive(&mut node, &ToNode::Inspected { node: NodeId(4) }),
            "NotInspected" => receive(&mut node, &ToNode::NotInspected { node: NodeId(4) }),
            "Described" => receive(&mut node, &described()),
            "CountersLost" => {
                // Only a node that was welcomed can have sent them.
                let _ = node.handle(NOW, Input::Counters);
                drain(&mut node);
                receive(&mut node, &ToNode::CountersLost)
            }
            "Reloaded" => receive(&mut node, &reloaded()),
            "Goodbye" => receive(&mut node, &ToNode::Goodbye { code: Code(3) }),
            "Eof" => node.handle(NOW, Input::Eof).map(|()| drain(&mut node)),
            other => panic!("{other} is not a frame"),
        };
        let over = || if node.is_away() { "away" } else { "ended" };
        let actual = match (&result, node.end()) {
            // In a session that is over, the reported end is the first one.
            (Err(Error::Ended(End::Violation(violation))), _) => violation.kind().name(),
            (_, Some(_)) => over(),
            (Ok(outputs), None) => match outputs[..] {
                [Output::HelloRefused(_)] => "refused",
                [Output::Welcomed { .. }] => "ready",
                [Output::Welcomed { .. }, ..] => "resuming",
                _ => "ok",
            },
            (Err(error), None) => panic!("{state} {frame}: {error}"),
        };
        assert_eq!(actual, cell, "{state} {frame}");
    }
}

/// Whether the node still has its interface: it can withdraw it.
fn stays(node: &Node) -> bool {
    let interface = InterfaceId(1);
    let withdrawn = node.clone().handle(NOW, Input::Withdraw { interface });
    withdrawn.is_ok()
}

//= SM2-IFC-002, SM2-IFC-003, SM2-IFC-004, SM2-FRM-004, SM2-LNK-003, SM2-LNK-004, SM2-ACC-013 test
//= SM2-RES-010 test
#[test]
fn every_state_of_an_interface_and_frame() {
    for (state, frame, cell) in table(INTERFACE) {
        let mut node = interface_in(state);
        let frame_sent = match frame {
            "Declared" => declared(1),
            "DeclareRefused" => refused(1),
            "DeclareDenied" => denied(1),
            "Link" => link(1, 2),
            "UnlinkOwn" => unlink(1, 1),
            "UnlinkOther" => unlink(1, 7),
            "Withdrawn" => withdrawn(1),
            other => panic!("{other} is not a frame"),
        };
        let actual = match receive(&mut node, &frame_sent) {
            Err(Error::Ended(End::Violation(violation))) => violation.kind().name(),
            Err(error) => panic!("{state} {frame}: {error}"),
            Ok(outputs) => match &outputs[..] {
                [] => "silent",
                [Output::Declared { .. }] => "live",
                [Output::DeclareRefused { .. }, Output::Transmit(_)] if stays(&node) => {
                    assert_eq!(sent(&outputs), [suspended(1)]);
                    "suspended"
                }
                [Output::DeclareRefused { .. } | Output::Withdrawn { .. }] => "gone",
                // The links that no Manager has claimed end here.
                [
                    Output::DeclareRefused { .. },
                    Output::Unlink { code, .. },
                    ..,
                ] => {
                    assert_eq!(*code, Farewell::Denied.code());
                    "left"
                }
                [Output::Linked { .. }] => "linked",
                [Output::Transmit(_), Output::Transmit(_), Output::Resumed] => {
                    let interface = InterfaceId(1);
                    match &sent(&outputs)[..] {
                        [first, ToManager::Claimed] if *first == claim(1) => "claimed",
                        [ToManager::Withdraw { interface: it }, ToManager::Claimed]
                            if *it == interface =>
                        {
                            "withdrawing"
                        }
                        other => panic!("{state} {frame}: {other:?}"),
                    }
                }
                [
                    Output::DeclareRefused { .. },
                    Output::Transmit(_),
                    Output::Resumed,
                ] => "kept",
                [
                    Output::Withdrawn { .. },
                    Output::Transmit(_),
                    Output::Resumed,
                ] => "forgotten",
                [Output::Unlink { .. }, Output::Transmit(_)] => {
                    assert_eq!(sent(&outputs), [unlinked(1, link_id(1))]);
                    "unlinked"
                }
                other => panic!("{state} {frame}: {other:?}"),
            },
        };
        assert_eq!(actual, cell, "{state} {frame}");
    }
}
