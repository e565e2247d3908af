//! The requests of a node to its Manager, and answers that were not requested (SPEC section 4.5).

use crate::support::{
    contracts::{data, name},
    session::{
        LATER, NOW, changes, come_back, contract, declared, drain, page, ready, receive, reloaded,
        schema, sent, violation, welcome, welcome_in,
    },
};
use sm2_proto::{
    Code, Machine, NodeId, TypeId,
    control::{Changes, ReloadOutcome, SchemaText, ToManager, ToNode},
    node::{Input, Misuse, Node, Output},
    violation,
};

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
            Ok([Output::Page(_)])
        ));
    }
    assert_eq!(
        violation(&mut node, &page()),
        violation!(UnexpectedPage, "SM2-IFC-007")
    );
}

//= SM2-WCH-001 test
#[test]
fn one_answer_for_each_watch() {
    let mut node = ready();
    let again = node.handle(NOW, Input::Watch { after: 9 });
    assert_eq!(again, Err(Misuse::WatchTwice.into()));
    assert!(matches!(
        receive(&mut node, &changes()).as_deref(),
        Ok([Output::Changes(Changes { revision: 2, .. })])
    ));
    let unasked = violation(&mut node.clone(), &changes());
    assert_eq!(unasked, violation!(UnexpectedChanges, "SM2-WCH-001"));
    node.handle(NOW, Input::Watch { after: 9 }).expect("ready");
    assert_eq!(sent(&drain(&mut node)), [ToManager::Watch { after: 9 }]);
}

//= SM2-ACC-016 test
#[test]
fn one_answer_for_each_reload() {
    let mut node = ready();
    let again = node.handle(NOW, Input::Reload);
    assert_eq!(again, Err(Misuse::ReloadTwice.into()));
    let answer = Output::Reloaded(ReloadOutcome::Applied);
    assert_eq!(receive(&mut node, &reloaded()), Ok(vec![answer]));
    let unasked = violation(&mut node.clone(), &reloaded());
    assert_eq!(unasked, violation!(UnexpectedReloaded, "SM2-ACC-016"));
    node.handle(NOW, Input::Reload).expect("ready");
    assert_eq!(sent(&drain(&mut node)), [ToManager::Reload]);
}

//= SM2-CNT-001 test
#[test]
fn counters_go_out_once_per_session() {
    let mut node = ready();
    node.handle(NOW, Input::Counters).expect("ready");
    let outputs = drain(&mut node);
    assert!(matches!(&outputs[..], [Output::TransmitCounters(_)]));
    let twice = node.handle(NOW, Input::Counters);
    assert_eq!(twice, Err(Misuse::CountersTwice.into()));
    come_back(&mut node);
    assert_eq!(node.handle(NOW, Input::Counters), Ok(()));
}

//= SM2-CNT-002 test
#[test]
fn counters_that_were_lost_go_out_again() {
    let mut node = ready();
    let early = violation(&mut node.clone(), &ToNode::CountersLost);
    assert_eq!(early, violation!(UnexpectedCounters, "SM2-CNT-002"));
    node.handle(NOW, Input::Counters).expect("ready");
    let first = drain(&mut node);
    for _ in 0..2 {
        assert_eq!(receive(&mut node, &ToNode::CountersLost), Ok(first.clone()));
    }
    come_back(&mut node);
    let early = violation(&mut node, &ToNode::CountersLost);
    assert_eq!(early, violation!(UnexpectedCounters, "SM2-CNT-002"));
}

/// The Manager learns it before it can make a link. The next Manager learns it as well.
//= SM2-LNK-007 test
#[test]
fn every_manager_learns_how_many_links_a_node_can_have() {
    let frame = |max_links| ToManager::MaxLinks { max_links };
    let mut node = Node::new(name("lidar"));
    let hello = sent(&drain(&mut node));
    assert!(matches!(hello[..], [ToManager::Hello { .. }]), "{hello:?}");
    node.handle(NOW, Input::MaxLinks(7)).expect("legal");
    assert_eq!(drain(&mut node), [], "not before WELCOME");
    let welcomed = receive(&mut node, &welcome()).expect("legal");
    assert_eq!(sent(&welcomed), [frame(7)]);
    node.declare(contract()).expect("ready");
    drain(&mut node);
    receive(&mut node, &declared(1)).expect("legal");
    node.handle(NOW, Input::MaxLinks(9)).expect("legal");
    assert_eq!(sent(&drain(&mut node)), [frame(9)]);
    node.handle(NOW, Input::Eof).expect("legal");
    node.handle(NOW, Input::MaxLinks(8)).expect("away");
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(&mut node);
    let back = sent(&receive(&mut node, &welcome_in(LATER)).expect("legal"));
    assert!(
        matches!(&back[..], [first, ToManager::Declare { .. }] if *first == frame(8)),
        "{back:?}"
    );
    node.handle(NOW, Input::Close(Code(0))).expect("legal");
    assert!(node.handle(NOW, Input::MaxLinks(1)).is_err());
}

//= SM2-CNT-003 test
#[test]
fn inspects_are_answered_in_their_order() {
    let mut node = ready();
    node.handle(NOW, Input::Inspect { node: NodeId(5) })
        .expect("ready");
    let frame = ToManager::Inspect { node: NodeId(5) };
    assert_eq!(sent(&drain(&mut node)), [frame]);
    let found = |node| ToNode::Inspected { node: NodeId(node) };
    let none = |node| ToNode::NotInspected { node: NodeId(node) };
    for early in [found(5), none(5)] {
        let early = violation(&mut node.clone(), &early);
        assert_eq!(early, violation!(UnexpectedCounters, "SM2-CNT-003"));
    }
    let answer = receive(&mut node, &found(4));
    assert_eq!(answer, Ok(vec![Output::Inspected { node: NodeId(4) }]));
    let answer = receive(&mut node, &none(5));
    assert_eq!(answer, Ok(vec![Output::NotInspected { node: NodeId(5) }]));
    for unasked in [found(4), none(5)] {
        let unasked = violation(&mut node.clone(), &unasked);
        assert_eq!(unasked, violation!(UnexpectedCounters, "SM2-CNT-003"));
    }
}

//= SM2-SCH-001, SM2-SCH-002 test
#[test]
fn a_schema_has_the_hash_of_its_type() {
    let (point, text) = schema();
    let other = data("Scan");
    let frame = |data: &TypeId, text: Option<&str>| ToNode::Described {
        data: data.clone(),
        text: text.map(str::to_owned),
    };
    let mut node = ready();
    let describe = Input::Describe {
        data: other.clone(),
    };
    node.handle(NOW, describe).expect("ready");
    let broken = |bad: ToNode| violation(&mut node.clone(), &bad);
    // Out of order, malformed, or of another type.
    assert_eq!(
        broken(frame(&other, None)),
        violation!(UnexpectedSchema, "SM2-SCH-002")
    );
    assert_eq!(
        broken(frame(&point, Some("x"))),
        violation!(BadSchema, "SM2-SCH-002")
    );
    assert_eq!(
        broken(frame(&point, Some("plain:u8"))),
        violation!(BadSchema, "SM2-SCH-002")
    );
    let described = |data: &TypeId, text: Option<&str>| Output::Described {
        data: data.clone(),
        text: text.map(str::to_owned),
    };
    drain(&mut node);
    for (data, text) in [(&point, Some(&*text)), (&other, None)] {
        let answer = receive(&mut node, &frame(data, text));
        assert_eq!(answer, Ok(vec![described(data, text)]));
    }
    let unasked = violation(&mut node.clone(), &frame(&point, None));
    assert_eq!(unasked, violation!(UnexpectedSchema, "SM2-SCH-002"));
    // The texts that the node registers are checked as well.
    let schema = |data: &TypeId, text: &str| {
        Input::Schema(SchemaText {
            data: data.clone(),
            text: text.to_owned(),
        })
    };
    for wrong in [schema(&other, &text), schema(&point, "x")] {
        assert_eq!(node.handle(NOW, wrong), Err(Misuse::Schema.into()));
    }
    node.handle(NOW, schema(&point, &text)).expect("its hash");
    let registered = ToManager::Schema(SchemaText { data: point, text });
    assert_eq!(sent(&drain(&mut node)), [registered]);
}
