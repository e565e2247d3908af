//! A Manager, a publisher, a subscriber and their link, without any I/O. Between two messages
//! the Manager dies and another one takes over; the link does not notice.
//!
//! Whoever embeds the machines writes three loops like `manager_works`,
//! `node_works` and `link_works`: poll until there is nothing, and carry out
//! each output. Here a datagram goes into a queue; elsewhere it goes into a
//! socket, and a [`Link`]'s datagrams into the descriptor that came with LINK.
//!
//! `cargo run -p sm2-proto --example in_memory`

use std::{collections::VecDeque, fmt::Debug};

use sm2_proto::{
    Contract, Datagram, Demand, Farewell, FdFacts, Instant, InterfaceId, Machine, Name, NodeId,
    Offer, TypeId, Violation,
    control::{decode_to_manager, decode_to_node},
    link::{
        self, Body, Config, Link, NoMemory, OutboundMessage, Payload, Role, Status, wire::Frame,
    },
    manager::{self, Credentials, Manager, Policy},
    node::{self, Node},
};

fn main() {
    World::new().run(&mut |line| println!("{line}"));
}

/// Machines never read a clock. Nothing here takes any time.
const NOW: Instant = Instant(0);
/// Who the kernel says our nodes are.
const WE: Credentials = Credentials {
    uid: 1000,
    gid: 1000,
    pid: 1,
};

/// A robot program: its node, its one interface, and that one's link.
struct Program {
    name: &'static str,
    node: Node,
    contract: Contract,
    interface: Option<InterfaceId>,
    link: Option<Link>,
}

/// A datagram on its way. Programs are numbered; their sessions count from 1.
enum Wire {
    /// To the Manager, from a program.
    Manager(usize, Vec<u8>),
    /// To a program's node.
    Node(usize, Vec<u8>, Vec<FdFacts>),
    /// To a program's link.
    Link(usize, Vec<u8>),
    /// To nobody: the Manager dies here, and another one takes its place.
    TakeOver,
}

/// Both programs, their Manager, and what is on its way between them.
pub(crate) struct World {
    manager: Manager,
    programs: [Program; 2],
    wires: VecDeque<Wire>,
}

fn name(text: &str) -> Name {
    Name::new(text).expect("it keeps to the grammar")
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
            offer: Offer {
                depth: 8,
                reliable: false,
                latched: 0,
                sealed: false,
            },
        };
        let subscriber = Contract::Subscriber {
            topic: name("scan"),
            data: Some(data),
            demand: Demand {
                depth: 8,
                reliable: false,
                max_borrowed: 2,
                sealed: false,
            },
        };
        let program = |text, contract| Program {
            name: text,
            node: Node::new(name(text)),
            contract,
            interface: None,
            link: None,
        };
        Self {
            manager: Manager::new(1, 7, Policy::default()),
            programs: [program("lidar", publisher), program("planner", subscriber)],
            wires: VecDeque::new(),
        }
    }

    /// Delivers one datagram after the other, until nobody has anything to say.
    pub(crate) fn run(&mut self, print: &mut dyn FnMut(String)) {
        for at in 0..self.programs.len() {
            self.feed_manager(manager::Input::Connected {
                session: session(at),
                credentials: WE,
            });
            self.node_works(at);
        }
        while let Some(wire) = self.wires.pop_front() {
            let read = wire.to_string(&self.programs);
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
            print(format!("{read}\n    {}", self.state(&wire)));
        }
    }

    /// What was on its way to the old Manager is lost with it. The new one knows nothing
    /// but what the nodes tell it.
    fn take_over(&mut self) {
        let link_only = |wire: &Wire| matches!(wire, Wire::Link(..));
        self.wires.retain(link_only);
        self.manager = Manager::new(2, 8, Policy::default());
        for at in 0..self.programs.len() {
            self.feed_node(at, node::Input::Eof);
            self.feed_manager(manager::Input::Connected {
                session: session(at),
                credentials: WE,
            });
            self.feed_node(at, node::Input::Reconnected);
        }
    }

    fn feed_manager(&mut self, input: manager::Input<'_>) {
        let taken = self.manager.handle(NOW, input);
        taken.expect("our session numbers grow");
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
                // Nobody here keeps counters.
                manager::Output::KeepCounters { .. } | manager::Output::SendCounters { .. } => {}
            }
        }
    }

    fn feed_node(&mut self, at: usize, input: node::Input<'_>) {
        let taken = self.programs[at].node.handle(NOW, input);
        taken.expect("neither we nor the Manager break the rules");
        self.node_works(at);
    }

    fn node_works(&mut self, at: usize) {
        while let Some(output) = self.programs[at].node.poll() {
            let program = &mut self.programs[at];
            match output {
                node::Output::Transmit(bytes) => self.wires.push_back(Wire::Manager(at, bytes)),
                node::Output::Welcomed { .. } if program.interface.is_none() => {
                    let interface = program.node.declare(program.contract.clone());
                    program.interface = Some(interface.expect("we are welcome"));
                }
                // Our link is known to the new Manager too. It never ceased to work.
                node::Output::Resumed if Role::of(program.contract.kind()) == Role::Sender => {
                    self.feed_link(at, message(2));
                }
                node::Output::Linked {
                    link,
                    version,
                    reliable,
                    sealed,
                    ..
                } => {
                    let config = Config::new(&program.contract, link, version, reliable, sealed);
                    program.link = Some(Link::new(config));
                    self.link_works(at);
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
                // The answers to what nobody here asks.
                node::Output::Page { .. }
                | node::Output::Changes { .. }
                | node::Output::TransmitCounters(_)
                | node::Output::Inspected { .. }
                | node::Output::NotInspected { .. }
                | node::Output::Described { .. } => {}
            }
        }
    }

    fn feed_link(&mut self, at: usize, input: link::Input<'_>) {
        if let Some(link) = &mut self.programs[at].link {
            // A link that is over says so; that is no concern of anybody's.
            let _ = link.handle(NOW, input);
            self.link_works(at);
        }
    }

    fn link_works(&mut self, at: usize) {
        while let Some(link) = &mut self.programs[at].link {
            if let Some(output) = link.poll() {
                self.carry_out(at, output);
            } else if let Ok(Some(delivery)) = link.take(&NoMemory) {
                // The application has it; here it gives it back at once.
                assert_eq!(delivery.payload, Payload::Inline("one scan".into()));
                let sequence = delivery.sequence;
                self.feed_link(at, link::Input::Release { sequence });
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
                self.feed_link(at, message(1));
            }
            link::Output::Settled { key: 1, .. } => self.wires.push_back(Wire::TakeOver),
            // The last message was given back: that was all that we wanted.
            link::Output::Settled { .. } => {
                if let Some(interface) = program.interface {
                    self.feed_node(at, node::Input::Withdraw { interface });
                    self.feed_link(at, link::Input::Close(Farewell::Done.code()));
                }
            }
            // Harmless where the Manager, or we, said so before.
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
            // Small messages travel in their datagrams: nothing to map or to keep.
            _ => {}
        }
    }

    /// How far whoever got the datagram has come by it.
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
    fn to_string(&self, programs: &[Program; 2]) -> String {
        let name = |at: &usize| programs[*at].name;
        match self {
            Self::Manager(from, bytes) => {
                let frame = decode_to_manager(&Datagram::new(bytes));
                format!("{} -> Manager: {}", name(from), readable(frame))
            }
            Self::Node(to, bytes, fds) => {
                let datagram = Datagram {
                    fds,
                    ..Datagram::new(bytes)
                };
                let frame = decode_to_node(&datagram);
                format!("Manager -> {}: {}", name(to), readable(frame))
            }
            Self::Link(to, bytes) => {
                let frame = Frame::decode(&Datagram::new(bytes));
                format!("{} -> {}: {}", name(&(1 - to)), name(to), readable(frame))
            }
            Self::TakeOver => "The Manager dies, and another one takes over".to_owned(),
        }
    }
}

fn readable(frame: Result<impl Debug, Violation>) -> String {
    match frame {
        Ok(frame) => format!("{frame:?}"),
        Err(violation) => violation.to_string(),
    }
}

fn message(key: u64) -> link::Input<'static> {
    link::Input::Send(OutboundMessage {
        key,
        id: key,
        time: NOW,
        status: Status::Ok,
        len: 8,
        body: Body::Inline("one scan".into()),
    })
}

fn session(program: usize) -> NodeId {
    NodeId(program as u64 + 1)
}

fn program(session: NodeId) -> usize {
    session.0 as usize - 1
}
