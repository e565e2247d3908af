//! The contract of the machines, checked through the trait alone.

use std::{
    fmt::Debug,
    panic::{AssertUnwindSafe, catch_unwind},
};

use sm2_proto::{
    Code, Datagram, Error, Instant, Machine, Name, NodeId,
    manager::{self, Credentials, Manager, Policy},
    node::{self, End, Node},
};

const NOW: Instant = Instant(0);

fn drain<M: Machine>(machine: &mut M) -> usize {
    core::iter::from_fn(|| machine.poll()).count()
}

/// A machine that has ended answers with its first reason, has no outputs, and no deadline.
fn ended_answers_with_its_first_reason<'a, M>(
    machine: &mut M,
    reason: &M::End,
    inputs: impl IntoIterator<Item = M::Input<'a>>,
) where
    M: Machine + Clone + Debug + PartialEq,
    M::End: Debug + PartialEq,
    M::Misuse: Debug,
{
    drain(machine);
    let ended = machine.clone();
    for input in inputs {
        match machine.handle(NOW, input) {
            Err(Error::Ended(end)) => assert_eq!(end, *reason),
            other => panic!("{other:?} instead of the end"),
        }
        assert_eq!(*machine, ended);
        assert_eq!(drain(machine), 0);
    }
    assert_eq!(machine.deadline(), None);
}

/// A second input trips the debug assertion as long as the outputs of the first one wait.
fn outputs_are_drained_first<M: Machine>(machine: &mut M, input: M::Input<'_>) {
    let fed = catch_unwind(AssertUnwindSafe(|| drop(machine.handle(NOW, input))));
    assert_eq!(fed.is_err(), cfg!(debug_assertions));
}

fn node() -> Node {
    Node::new(Name::new("node").unwrap())
}

#[test]
fn an_ended_node_answers_with_its_first_reason() {
    let mut node = node();
    let code = Code(7);
    drain(&mut node);
    assert_eq!(node.handle(NOW, node::Input::Close(code)), Ok(()));
    let inputs = [
        node::Input::Eof,
        node::Input::Datagram(Datagram::new(&[0])),
        node::Input::Reconnected,
        node::Input::Query { after: None },
        node::Input::Close(Code(8)),
    ];
    ended_answers_with_its_first_reason(&mut node, &End::Local(code), inputs);
}

#[test]
fn a_node_is_drained_before_the_next_datagram() {
    let datagram = Datagram::new(&[0]);
    outputs_are_drained_first(&mut node(), node::Input::Datagram(datagram));
}

#[test]
fn a_manager_is_drained_before_the_next_input() {
    let mut manager = Manager::new(1, 2, Policy::default());
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    let session = NodeId(1);
    let connected = manager::Input::Connected {
        session,
        credentials,
    };
    assert_eq!(manager.handle(NOW, connected), Ok(()));
    // It says nothing until there is something to answer: an unknown frame ends the session.
    let datagram = Datagram::new(&[0xff]);
    let unknown = manager::Input::Datagram { session, datagram };
    assert_eq!(manager.handle(NOW, unknown), Ok(()));
    outputs_are_drained_first(&mut manager, manager::Input::Tick);
}
