//! A Manager, a publisher, a subscriber and their link, without any I/O. Between two messages
//! the Manager dies and another one takes over; the link does not notice.
//!
//! A program that embeds the machines has three loops like `drain_manager`, `drain_node` and
//! `drain_link`: they poll until no output is left, and carry out each output. Here a datagram
//! goes into a queue. A real program writes it to a socket: a [`Link`]'s datagrams go to the
//! descriptor that came with LINK.
//!
//! SPEC, Annex C, has the bytes of this session; a test compares them.
//!
//! `cargo run -p sm2-proto --example in_memory`

use std::collections::VecDeque;
use std::fmt::{self, Debug, Display, Formatter};

use sm2_proto::{
    Contract, Datagram, DemandedQos, Farewell, FdFacts, Instant, InterfaceId, LinkQos, Machine,
    Name, NodeId, OfferedQos, TypeId, Violation,
    control::{Limits, decode_to_manager, decode_to_node},
    link::{
        self, Body, Config, Link, NoMemory, OutboundMessage, Payload, Publications, Role, Status,
        wire::Frame,
    },
    manager::{self, Credentials, Manager},
    node::{self, Node},
};

fn main() {
    World::new().run(&mut |step| println!("{step}"));
}

/// The time of every event: machines never read a clock, and time stands still here.
const NOW: Instant = Instant(0);
/// The OPEN of the publisher has its number, which a program draws at random, and says that it has published nothing.
const PUBLICATIONS: Publications = Publications {
    publisher: 0x1fb6_04e8_9152_3c7d,
    published: 0,
};
/// The credentials of both nodes, as the kernel would give them.
const CREDENTIALS: Credentials = Credentials {
    uid: 1000,
    gid: 1000,
    pid: 1,
};

/// A robot program: its node, its only interface, and the link of this interface.
struct Program {
    name: &'static str,
    node: Node,
    contract: Contract,
    interface: Option<InterfaceId>,
    link: Option<Link>,
}

/// A datagram on its way. A program is an index; its session is that index plus 1.
enum Wire {
    /// To the Manager, from a program.
    Manager(usize, Vec<u8>),
    /// To a program's node.
    Node(usize, Vec<u8>, Vec<FdFacts>),
    /// To a program's link.
    Link(usize, Vec<u8>),
    /// No datagram: the Manager dies here, and another one takes over.
    TakeOver,
}

/// A datagram that was delivered.
pub(crate) struct Step {
    /// Its sender and its receiver: `lidar -> Manager`.
    pub(crate) route: String,
    /// The frame in it, as text.
    frame: String,
    /// Its bytes; none where the Manager dies.
    #[cfg_attr(
        not(test),
        allow(dead_code, reason = "the test of SPEC's Annex C reads them")
    )]
    pub(crate) bytes: Vec<u8>,
    /// The state of its receiver afterwards.
    state: String,
}

impl Display for Step {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self {
            route,
            frame,
            state,
            ..
        } = self;
        write!(f, "{route}{frame}\n    {state}")
    }
}

/// Both programs, their Manager, and the datagrams on their way.
pub(crate) struct World {
    manager: Manager,
    programs: [Program; 2],
    wires: VecDeque<Wire>,
}

fn name(text: &str) -> Name {
    Name::new(text).expect("the name is valid")
}

impl World {
    pub(crate) fn new() -> Self {
        let data = TypeId {
            name: name("Scan"),
            hash: 1,
        };
        let publisher = Contract::Publisher {
            topic: name("scan"),
            data: data.clone(),
            offer: OfferedQos::new(8),
        };
        let subscriber = Contract::Subscriber {
            topic: name("scan"),
            data: Some(data),
            demand: DemandedQos::new(8, 2),
        };
        let program = |text, contract| Program {
            name: text,
            node: Node::new(name(text)),
            contract,
            interface: None,
            link: None,
        };
        Self {
            manager: Manager::new(1, 7, Limits::default()),
            programs: [program("lidar", publisher), program("planner", subscriber)],
            wires: VecDeque::new(),
        }
    }

    /// Delivers one datagram after the other until none is left, and reports each.
    pub(crate) fn run(&mut self, report: &mut dyn FnMut(Step)) {
        for at in 0..self.programs.len() {
            self.feed_manager(manager::Input::Connected {
                session: session(at),
                credentials: CREDENTIALS,
            });
            self.drain_node(at);
        }
        while let Some(wire) = self.wires.pop_front() {
            let mut step = wire.step(&self.programs);
            match &wire {
                Wire::Manager(from, bytes) => self.feed_manager(manager::Input::Datagram {
                    session: session(*from),
                    datagram: Datagram::new(bytes),
                }),
                Wire::Node(to, bytes, fds) => {
                    let fds = &fds[..];
                    let datagram = Datagram {
                        fds,
                        ..Datagram::new(bytes)
                    };
                    self.feed_node(*to, node::Input::Datagram(datagram));
                }
                Wire::Link(to, bytes) => {
                    self.feed_link(*to, link::Input::Datagram(Datagram::new(bytes)));
                }
                Wire::TakeOver => self.take_over(),
            }
            step.state = self.state(&wire);
            report(step);
        }
    }

    /// Datagrams on their way to the old Manager are lost with it. The new Manager learns everything
    /// from the nodes.
    fn take_over(&mut self) {
        let link_only = |wire: &Wire| matches!(wire, Wire::Link(..));
        self.wires.retain(link_only);
        self.manager = Manager::new(2, 8, Limits::default());
        for at in 0..self.programs.len() {
            self.feed_node(at, node::Input::Eof);
            self.feed_manager(manager::Input::Connected {
                session: session(at),
                credentials: CREDENTIALS,
            });
            self.feed_node(at, node::Input::Reconnected);
        }
    }

    fn feed_manager(&mut self, input: manager::Input<'_>) {
        let taken = self.manager.handle(NOW, input);
        taken.expect("session numbers grow");
        while let Some(output) = self.manager.poll() {
            match output {
                manager::Output::Send { session, frame } => {
                    self.wires
                        .push_back(Wire::Node(program(session), frame, vec![]));
                }
                // A driver makes a socket pair here, and sends one end with each.
                manager::Output::Link { ends, .. } => {
                    for (session, frame) in ends {
                        let socket = vec![FdFacts::default()];
                        self.wires
                            .push_back(Wire::Node(program(session), frame, socket));
                    }
                }
                manager::Output::HangUp {
                    session, goodbye, ..
                } => {
                    let goodbye = goodbye.map(|it| Wire::Node(program(session), it, vec![]));
                    self.wires.extend(goodbye);
                }
                // No node here keeps counters.
                manager::Output::KeepCounters { .. } | manager::Output::SendCounters { .. } => {}
                // Nor has the policy read again.
                manager::Output::ReadAccessPolicy => {}
            }
        }
    }

    fn feed_node(&mut self, at: usize, input: node::Input<'_>) {
        let taken = self.programs[at].node.handle(NOW, input);
        taken.expect("neither side breaks a rule");
        self.drain_node(at);
    }

    fn drain_node(&mut self, at: usize) {
        while let Some(output) = self.programs[at].node.poll() {
            let program = &mut self.programs[at];
            match output {
                node::Output::Transmit(bytes) => self.wires.push_back(Wire::Manager(at, bytes)),
                node::Output::Welcomed { .. } if program.interface.is_none() => {
                    let interface = program.node.declare(program.contract.clone());
                    program.interface = Some(interface.expect("the node has a session"));
                }
                // The new Manager knows the link too. The link has worked all the time.
                node::Output::Resumed if Role::of(program.contract.kind()) == Role::Sender => {
                    self.send(at, message(2));
                }
                node::Output::Linked {
                    link, version, qos, ..
                } => {
                    let LinkQos { reliable, sealed } = qos;
                    let config = Config {
                        publications: PUBLICATIONS,
                        ..Config::new(&program.contract, link, version, reliable, sealed)
                    };
                    program.link = Some(Link::new(config));
                    self.drain_link(at);
                }
                node::Output::Unlink { code, .. } => self.feed_link(at, link::Input::Close(code)),
                node::Output::Withdrawn { .. } => {
                    self.feed_node(at, node::Input::Close(Farewell::Done.code()));
                }
                node::Output::Welcomed { .. }
                | node::Output::HelloRefused(_)
                | node::Output::Declared { .. }
                | node::Output::DeclareRefused { .. }
                | node::Output::Resumed
                | node::Output::Ended(_) => {}
                // No datagram here loses its descriptor, and no node asks for anything.
                node::Output::LinkLost { .. }
                | node::Output::Page(_)
                | node::Output::Changes(_)
                | node::Output::TransmitCounters(_)
                | node::Output::Inspected { .. }
                | node::Output::NotInspected { .. }
                | node::Output::Described { .. }
                | node::Output::Reloaded(_) => {}
            }
        }
    }

    fn feed_link(&mut self, at: usize, input: link::Input<'_>) {
        if let Some(link) = &mut self.programs[at].link {
            // A link that has ended refuses input, which is expected here.
            let _ = link.handle(NOW, input);
            self.drain_link(at);
        }
    }

    fn send(&mut self, at: usize, message: OutboundMessage) {
        if let Some(link) = &mut self.programs[at].link {
            // On the socket lane the outputs say what became of it.
            let _ = link.send(&NoMemory, message, |_, _| {});
            self.drain_link(at);
        }
    }

    fn drain_link(&mut self, at: usize) {
        while let Some(link) = &mut self.programs[at].link {
            if let Some(output) = link.poll() {
                self.carry_out(at, output);
            } else if let Ok(Some(delivery)) = link.take(&NoMemory) {
                // The application takes the message, and releases it at once.
                assert_eq!(delivery.payload, Payload::Inline("one scan".into()));
                let sequence = delivery.sequence;
                let _ = link.release(&NoMemory, sequence);
            } else {
                return;
            }
        }
    }

    fn carry_out(&mut self, at: usize, output: link::Output) {
        let program = &self.programs[at];
        match output {
            link::Output::Transmit(packet) => {
                let other = 1 - at;
                self.wires.push_back(Wire::Link(other, packet.to_vec()));
            }
            link::Output::Opened if Role::of(program.contract.kind()) == Role::Sender => {
                self.send(at, message(1));
            }
            link::Output::Settled { key: 1, .. } => self.wires.push_back(Wire::TakeOver),
            // The subscriber has released the last message: the publisher withdraws.
            link::Output::Settled { .. } => {
                if let Some(interface) = program.interface {
                    self.feed_node(at, node::Input::Withdraw { interface });
                    self.feed_link(at, link::Input::Close(Farewell::Done.code()));
                }
            }
            // The node machine ignores this if the link was unlinked before.
            link::Output::Ended(_) => {
                if let (Some(interface), Some(link)) = (program.interface, &program.link) {
                    let unlinked = node::Input::Unlinked {
                        interface,
                        link: link.config().id,
                        code: Farewell::Done.code(),
                    };
                    self.feed_node(at, unlinked);
                }
            }
            // Small messages travel inline: there is no memory to map or to keep.
            _ => {}
        }
    }

    /// The state of the receiver after the datagram.
    fn state(&self, wire: &Wire) -> String {
        match wire {
            Wire::Manager(..) => {
                let (sessions, links) = (self.manager.sessions(), self.manager.links());
                format!("the Manager has {sessions} sessions and {links} links")
            }
            Wire::Node(to, ..) => {
                let Program { name, node, .. } = &self.programs[*to];
                match (node.id(), node.end()) {
                    (_, Some(end)) => format!("{name}: {end}"),
                    (Some(_), None) if node.is_ready() => format!("{name} is ready"),
                    (Some(_), None) => format!("{name} is resuming"),
                    (None, None) => format!("{name} is greeting"),
                }
            }
            Wire::TakeOver => "their link is open as ever".to_owned(),
            Wire::Link(to, _) => {
                let Program { name, link, .. } = &self.programs[*to];
                match link.as_ref().map(|link| (link.is_open(), link.end())) {
                    Some((_, Some(end))) => format!("{name}'s link: {end}"),
                    Some((true, None)) => format!("{name}'s link is open"),
                    _ => format!("{name}'s link is opening"),
                }
            }
        }
    }
}

impl Wire {
    fn step(&self, programs: &[Program; 2]) -> Step {
        let name = |at: &usize| programs[*at].name;
        let (route, frame, bytes) = match self {
            Self::Manager(from, bytes) => {
                let frame = readable(decode_to_manager(&Datagram::new(bytes)));
                (format!("{} -> Manager", name(from)), frame, bytes.clone())
            }
            Self::Node(to, bytes, fds) => {
                let datagram = Datagram {
                    fds,
                    ..Datagram::new(bytes)
                };
                let frame = readable(decode_to_node(&datagram));
                (format!("Manager -> {}", name(to)), frame, bytes.clone())
            }
            Self::Link(to, bytes) => {
                let frame = readable(Frame::decode(&Datagram::new(bytes)));
                let route = format!("{} -> {}", name(&(1 - to)), name(to));
                (route, frame, bytes.clone())
            }
            Self::TakeOver => {
                let event = "The Manager dies, and another one takes over";
                (event.to_owned(), String::new(), Vec::new())
            }
        };
        Step {
            route,
            frame,
            bytes,
            state: String::new(),
        }
    }
}

fn readable(frame: Result<impl Debug, Violation>) -> String {
    match frame {
        Ok(frame) => format!(": {frame:?}"),
        Err(violation) => format!(": {violation}"),
    }
}

fn message(key: u64) -> OutboundMessage {
    OutboundMessage {
        key,
        id: key,
        time: NOW,
        status: Status::Ok,
        len: 8,
        body: Body::Inline("one scan".into()),
    }
}

fn session(program: usize) -> NodeId {
    NodeId(program as u64 + 1)
}

fn program(session: NodeId) -> usize {
    session.0 as usize - 1
}
