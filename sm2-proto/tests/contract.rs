//! The contract of the machines, checked through the trait alone.

use sm2_proto::control::Limits;
use std::{
    fmt::Debug,
    panic::{AssertUnwindSafe, catch_unwind},
};

use sm2_proto::{
    Code, Contract, Datagram, DemandedQos, Error, Instant, LinkId, Machine, Name, NodeId, TypeId,
    VERSION,
    gateway::{
        Action, GatewayId, Hop, OfferId, Pattern, Rule, Rules, Subject,
        discovery::{self, Discovery},
        router::{self, Router},
        schedule::{self, QueuedMessage, Schedule, SendQos},
        session::{self, Command, ControlCommand, PeerEvent, PeerSession},
    },
    link::{self, Link, wire},
    manager::{self, Credentials, Manager},
    node::{self, End, Node},
};

const NOW: Instant = Instant(0);
const LINK: LinkId = LinkId {
    epoch: 1,
    serial: 1,
};

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

/// The receiving end of a link, whose OPEN was drained.
fn link() -> Link {
    let contract = Contract::Subscriber {
        topic: Name::new("scan").unwrap(),
        data: None,
        demand: DemandedQos::new(1, 1),
    };
    let config = link::Config::new(&contract, LINK, VERSION, false, false);
    let mut link = Link::new(config);
    assert_eq!(drain(&mut link), 1);
    link
}

#[test]
fn an_ended_link_answers_with_its_first_reason() {
    let mut link = link();
    let code = Code(7);
    assert_eq!(link.handle(NOW, link::Input::Close(code)), Ok(()));
    let inputs = [
        link::Input::Eof,
        link::Input::Datagram(Datagram::new(&[0])),
        link::Input::SegmentMissing,
        link::Input::Writable,
        link::Input::Close(Code(8)),
    ];
    ended_answers_with_its_first_reason(&mut link, &link::End::Local(code), inputs);
}

#[test]
fn a_link_is_drained_before_the_next_datagram() {
    let mut link = link();
    let open = wire::Frame::Open(wire::Open {
        role: link::Role::Sender as u8,
        version: VERSION,
        window: 0,
        link: LINK,
        lanes: wire::LANE_SOCKET,
        max_len: 0,
        publications: link::Publications::UNKNOWN,
    });
    let open = open.to_vec();
    let datagram = Datagram::new(&open);
    assert_eq!(link.handle(NOW, link::Input::Datagram(datagram)), Ok(()));
    let doorbell = link::doorbell();
    let datagram = Datagram::new(&doorbell);
    outputs_are_drained_first(&mut link, link::Input::Datagram(datagram));
}

#[test]
fn a_manager_is_drained_before_the_next_input() {
    let mut manager = Manager::new(1, 2, Limits::default());
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

const PEER: GatewayId = GatewayId([2; 32]);

fn me() -> Hop {
    Hop {
        gateway: GatewayId([1; 32]),
        epoch: 7,
    }
}

fn session() -> PeerSession {
    PeerSession::new(NOW, me(), Name::new("gateway").unwrap(), PEER, 0)
}

#[test]
fn an_ended_session_of_a_gateway_answers_with_its_first_reason() {
    let violation = {
        let mut session = session();
        drain(&mut session);
        // A frame of 0 bytes is a violation: the input that ends the session says so itself.
        let control = session::Input::Event(PeerEvent::Control(&[0; 4]));
        let answer = session.handle(NOW, control);
        let end = session.end().unwrap();
        assert_eq!(answer, Err(Error::Ended(end)));
        (session, end)
    };
    let closed = {
        let mut session = session();
        drain(&mut session);
        let code = Code(7);
        assert_eq!(session.handle(NOW, session::Input::Close(code)), Ok(()));
        (session, session::End::Local(code))
    };
    for (mut session, end) in [violation, closed] {
        let offer = OfferId(1);
        let inputs = [
            session::Input::Event(PeerEvent::Control(&[1])),
            session::Input::Event(PeerEvent::Closed(None)),
            session::Input::Command(Command::Control(ControlCommand::Unoffer { offer })),
            session::Input::Close(Code(8)),
            session::Input::Tick,
        ];
        ended_answers_with_its_first_reason(&mut session, &end, inputs);
    }
}

#[test]
fn a_session_of_a_gateway_is_drained_before_the_next_input() {
    // Its own HELLO waits.
    outputs_are_drained_first(&mut session(), session::Input::Tick);
}

#[test]
fn a_router_is_drained_before_the_next_input() {
    let allow = Rule {
        action: Action::Allow,
        kind: None,
        names: Pattern::new("**").unwrap(),
        direction: None,
        peers: None,
    };
    let mut router = Router::new(me(), Rules(vec![allow]));
    assert_eq!(router.handle(NOW, router::Input::Up { peer: PEER }), Ok(()));
    let name = Name::new("scan").unwrap();
    let data = TypeId {
        name: name.clone(),
        hash: 1,
    };
    let subject = Subject::Topic {
        name,
        data,
        reliable: false,
        latched: 0,
    };
    let shown = router::Input::Offered {
        peer: PEER,
        offer: OfferId(1),
        subject: subject.clone(),
        path: vec![Hop {
            gateway: PEER,
            epoch: 1,
        }],
    };
    assert_eq!(router.handle(NOW, shown), Ok(()));
    // The answer to an output may come while the others wait.
    let taken = router::Input::Taken {
        subject,
        origin: PEER,
        taken: Some(1),
    };
    assert_eq!(router.handle(NOW, taken), Ok(()));
    assert_eq!(router.deadline(), None);
    outputs_are_drained_first(&mut router, router::Input::Down { peer: PEER });
}

#[test]
fn discovery_is_drained_before_the_next_input() {
    let announces = true;
    let mut discovery = Discovery::new(NOW, me().gateway, 1, announces);
    assert_eq!(discovery.deadline(), Some(NOW));
    assert_eq!(discovery.handle(NOW, discovery::Input::Tick), Ok(()));
    // An attempt that could not begin may be reported while other outputs wait.
    let failed = discovery::Input::Failed { peer: PEER };
    assert_eq!(discovery.handle(NOW, failed), Ok(()));
    outputs_are_drained_first(&mut discovery, discovery::Input::Tick);
}

#[test]
fn a_schedule_is_drained_before_the_next_input() {
    let offer = OfferId(1);
    let qos = SendQos {
        depth: 1,
        priority: 0,
        messages_per_s: None,
        bytes_per_s: None,
        max_age: None,
    };
    let message = QueuedMessage {
        message: "scan",
        len_bytes: 4,
        published_at: NOW,
    };
    let mut schedule = Schedule::default();
    assert_eq!(
        schedule.handle(NOW, schedule::Input::Open { offer, qos }),
        Ok(())
    );
    // The second message displaces the first, which is an output.
    for _ in 0..2 {
        assert_eq!(drain(&mut schedule), 0);
        let enqueue = schedule::Input::Enqueue { offer, message };
        assert_eq!(schedule.handle(NOW, enqueue), Ok(()));
    }
    assert_eq!(schedule.deadline(), None);
    outputs_are_drained_first(&mut schedule, schedule::Input::Tick);
}
