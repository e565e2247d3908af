//! Harnesses for a node as a whole: its numbers, and its silence after the end.

use super::{
    End, Error, Input, Misuse, Node, Output,
    phase::{Interfaces, OpenSession, Phase},
};
use crate::{
    Code, Datagram, Farewell, Instant, InterfaceId, LinkId, Machine, Name, NodeId,
    proofs::{below, one_of, subscriber},
};

const NOW: Instant = Instant(0);

fn name() -> Name {
    Name::new("n").expect("a legal name")
}

fn node(phase: Phase) -> Node {
    let mut node = Node::new(name());
    node.outputs.clear();
    node.phase = phase;
    node
}

/// The interfaces of a node that was welcomed and has declared none.
fn known() -> Option<Interfaces> {
    Some(Interfaces::new())
}

fn session() -> OpenSession {
    OpenSession::new(NodeId(1), 2, Interfaces::new())
}

/// CLI-IDS: an interface gets a number that is greater than all numbers before it, from any count.
/// When no number is left, nothing is declared.
//= SM2-IFC-001 kani
// Shows CLI-IDS (BoundariesAndSamples), bound: any count; ready, resuming or away.
#[cfg_attr(kani, kani::proof)]
// Names of one byte, frames of at most 24.
#[cfg_attr(kani, kani::unwind(26))]
fn interface_numbers_are_fresh() {
    let mut node = node(one_of(&[
        Phase::Ready(session()),
        Phase::Resuming(session()),
        Phase::Away(End::Eof, known()),
    ]));
    let last: u64 = kani::any();
    let interfaces = node.phase.interfaces_mut().expect("welcomed");
    interfaces.last = InterfaceId(last);
    let before = node.clone();
    let declared = node.declare(subscriber());
    if last == u64::MAX {
        assert_eq!(declared, Err(Error::Misuse(Misuse::NumbersSpent)));
        assert!(node == before);
    } else {
        let interface = InterfaceId(last + 1);
        assert_eq!(declared, Ok(interface));
        let interfaces = node.phase.interfaces_mut().expect("welcomed");
        assert_eq!(interfaces.last, interface);
        assert!(interfaces.by_id.contains_key(&interface));
        // DECLARE goes out at once if the session is ready, otherwise after CLAIMED.
        let ready = node.is_ready();
        let declaring = node.phase.session().map_or(0, |it| it.declaring.len());
        assert_eq!(declaring, usize::from(ready));
        assert_eq!(node.outputs.len(), usize::from(ready));
        kani::cover!(ready && last > u64::from(u32::MAX), "beyond 32 bits");
    }
    kani::cover!(last == u64::MAX, "no number is left");
}

/// CLI-ABSORB: after its own end a node answers every input with its first reason, and sends
/// nothing. While it is away, it takes no input that needs a session.
//= SM2-NOD-001, SM2-NOD-003, SM2-SES-005 kani
// Shows CLI-ABSORB (Exhaustive), bound: any phase without interfaces; 3 ends, 8 late inputs.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(26))]
fn an_ended_node_is_silent() {
    let mut node = node(one_of(&[
        Phase::Greeting(known()),
        Phase::Refused(known()),
        Phase::Ready(session()),
        Phase::Away(End::Eof, known()),
    ]));
    let was_away = node.is_away();
    let code = Farewell::Done.code();
    let violation = violation!(UnknownFrame, "SM2-FRM-001");
    let (end, input) = match below(3) {
        0 => (End::Local(code), Input::Close(code)),
        1 => (End::Eof, Input::Eof),
        _ => {
            let datagram = Datagram::new(&[0xff]);
            (End::Violation(violation), Input::Datagram(datagram))
        }
    };
    let is_final = end == End::Local(code);
    let breaks = end == End::Violation(violation);
    // A session that does not exist cannot end.
    kani::assume(is_final || !was_away);
    let verdict = node.handle(NOW, input);
    assert_eq!(verdict.is_err(), breaks);
    let mut farewells = 0;
    let mut last = None;
    while let Some(output) = node.poll() {
        farewells += usize::from(matches!(output, Output::Transmit(_)));
        last = Some(output);
    }
    assert!(last == Some(Output::Ended(end)));
    assert_eq!(farewells, usize::from((is_final && !was_away) || breaks));
    assert_eq!((node.end(), node.is_away()), (Some(end), !is_final));
    let later = match below(9) {
        0 => Input::Datagram(Datagram::new(&[8, 0])),
        1 => Input::Eof,
        2 => Input::Greet(name()),
        3 => Input::Query { after: None },
        4 => Input::Watch { after: 0 },
        5 => Input::Counters,
        6 => Input::Inspect { node: NodeId(1) },
        7 => Input::Reload,
        _ => Input::Unlinked {
            interface: InterfaceId(1),
            link: LinkId::FIRST,
            code: Code(0),
        },
    };
    // While the node is away, links can still end, but there is no Manager to tell.
    let forgets = matches!(later, Input::Unlinked { .. }) && !is_final;
    let before = node.clone();
    let verdict = node.handle(NOW, later);
    assert_eq!(
        verdict,
        if forgets {
            Ok(())
        } else {
            Err(Error::Ended(end))
        }
    );
    assert!(node == before && node.poll().is_none());
    if is_final {
        assert_eq!(node.declare(subscriber()), Err(Error::Ended(end)));
        assert_eq!(node.handle(NOW, Input::Reconnected), Err(Error::Ended(end)));
        assert_eq!(node.handle(NOW, Input::Close(code)), Err(Error::Ended(end)));
        assert!(node == before);
    }
    kani::cover!(is_final && was_away, "closed without a session");
    kani::cover!(breaks, "the Manager broke SPEC");
}

#[cfg(test)]
kani::explored! {
    interface_numbers_are_fresh: 2,
    an_ended_node_is_silent: 2,
}
