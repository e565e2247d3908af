//! The body of the fuzz target `node_session`.
//!
//! The bytes are a list of datagrams of a hostile Manager and of requests of the program.
//! [`SessionModel`] is the view of a correct Manager: whatever the Manager sends, the node must not
//! break SPEC.

use alloc::{collections::BTreeSet, vec::Vec};

use super::{End, Error, Input, Node, Output};
use crate::{
    Datagram, FdFacts, Instant, InterfaceId, LinkId, LinkKey, Machine, Name,
    control::{
        Changes, LinkPeer, Page, ReloadOutcome, SchemaText, ToManager, ToNode, decode_to_manager,
        decode_to_node, encode_to_node,
    },
    fuzz::script::Script,
    manager::{Phase, ToManagerKind, legal},
};

const NOW: Instant = Instant(0);
const FD: [FdFacts; 2] = [FdFacts {
    regular: false,
    size_bytes: 0,
    seals: crate::Seals(0),
}; 2];

/// The node takes any bytes and sends only frames that its Manager has to accept. After its end it
/// answers with its first reason.
//= SM2-FRM-001, SM2-NOD-001, SM2-NOD-003 fuzz
pub(crate) fn session(data: &[u8]) {
    let Ok(name) = Name::new("node") else {
        return;
    };
    let mut fuzz = Fuzz {
        script: Script::new(data),
        node: Node::new(name),
        session: Some(SessionModel::default()),
        welcomed: false,
        granted: BTreeSet::new(),
    };
    fuzz.drain();
    while fuzz.step().is_some() {}
    let first = match fuzz.node.end() {
        Some(end) if !fuzz.node.is_away() => end,
        _ => End::Local(crate::Code(0)),
    };
    // Has no effect if the node has ended already.
    let closed = fuzz.node.handle(NOW, Input::Close(crate::Code(0)));
    assert!(closed.is_ok() || closed == Err(Error::Ended(first)));
    fuzz.drain();
    for input in [
        Input::Datagram(Datagram::new(&[])),
        Input::Eof,
        Input::Reconnected,
        Input::Close(crate::Code(1)),
        Input::Query { after: None },
        Input::Watch { after: 0 },
    ] {
        assert_eq!(fuzz.node.handle(NOW, input), Err(Error::Ended(first)));
    }
    assert_eq!((fuzz.node.end(), fuzz.node.poll()), (Some(first), None));
}

/// The state of one session as a correct Manager knows it.
struct SessionModel {
    phase: Phase,
    /// Whether a greeting waits for its answer.
    greeted: bool,
    resuming: bool,
    last_interface: u64,
    live: BTreeSet<InterfaceId>,
    /// WITHDRAW is sent, and WITHDRAWN has not come.
    dropping: BTreeSet<InterfaceId>,
    /// Links that the node may say farewell to.
    links: BTreeSet<(InterfaceId, LinkId)>,
    /// WATCH, RELOAD and COUNTERS that were sent, and that the Manager has not answered. It answers COUNTERS only if
    /// they were lost.
    unanswered: BTreeSet<ToManagerKind>,
    /// The interface of the DECLARE_REFUSED that was received last.
    refused: Option<InterfaceId>,
}

impl Default for SessionModel {
    fn default() -> Self {
        Self {
            phase: Phase::Greeting,
            greeted: false,
            resuming: false,
            last_interface: 0,
            live: BTreeSet::new(),
            dropping: BTreeSet::new(),
            links: BTreeSet::new(),
            unanswered: BTreeSet::new(),
            refused: None,
        }
    }
}

impl SessionModel {
    /// The node has taken a frame of the Manager as legal.
    /// `granted` has the interfaces that the Manager of any session has granted.
    fn taken(&mut self, frame: &ToNode, granted: &mut BTreeSet<InterfaceId>) {
        match *frame {
            ToNode::Welcome { .. } => {
                self.greeted = false;
                self.phase = if self.resuming {
                    Phase::Resuming
                } else {
                    Phase::Ready
                };
            }
            ToNode::HelloRefused { .. } => self.greeted = false,
            ToNode::DeclareRefused {
                interface,
                ref reason,
            } => {
                self.refused = Some(interface);
                // The Manager keeps an interface that a policy denies, if the node had it before (SM2-RES-010).
                let was_granted = granted.contains(&interface);
                if reason.is_denial() && was_granted && !self.dropping.contains(&interface) {
                    self.live.insert(interface);
                }
            }
            ToNode::Declared { interface, .. } => {
                granted.insert(interface);
                self.live.insert(interface);
            }
            ToNode::Link {
                interface, link, ..
            } => {
                // A LINK that crossed WITHDRAW is legal and has no effect (SM2-IFC-004).
                if self.live.contains(&interface) {
                    self.links.insert((interface, link));
                } else {
                    assert!(self.dropping.contains(&interface), "{interface} is unknown");
                }
            }
            ToNode::Withdrawn { interface } => {
                assert!(self.dropping.remove(&interface), "{interface} stays");
            }
            ToNode::Changes(_) => drop(self.unanswered.remove(&ToManagerKind::Watch)),
            ToNode::Reloaded { .. } => drop(self.unanswered.remove(&ToManagerKind::Reload)),
            // The node sends its counters once more.
            ToNode::CountersLost => {
                let were_sent = self.unanswered.remove(&ToManagerKind::Counters);
                assert!(were_sent, "counters that were not sent");
            }
            _ => {}
        }
    }

    /// The node sends a frame.
    fn sent(&mut self, frame: &ToManager) {
        let allowed = legal(self.phase, ToManagerKind::of(frame));
        assert_eq!(allowed, Ok(()), "{frame:?} while {:?}", self.phase);
        let mut sent_once = || self.unanswered.insert(ToManagerKind::of(frame));
        match *frame {
            ToManager::Hello { resuming, .. } => {
                assert!(!self.greeted, "one greeting at a time");
                (self.greeted, self.resuming) = (true, resuming);
            }
            ToManager::Declare { interface, .. } => {
                assert!(self.last_interface < interface.0, "numbers grow");
                self.last_interface = interface.0;
            }
            ToManager::Withdraw { interface } => {
                assert!(self.live.remove(&interface), "{interface} is live");
                self.dropping.insert(interface);
                self.links.retain(|(of, _)| *of != interface);
            }
            ToManager::Unlinked {
                interface, link, ..
            } => {
                assert!(self.links.remove(&(interface, link)), "{link} is known");
            }
            ToManager::Claim {
                interface, link, ..
            } => {
                assert!(self.live.contains(&interface), "{interface} is live");
                assert!(self.links.insert((interface, link)), "claimed once");
            }
            ToManager::Claimed => self.phase = Phase::Ready,
            ToManager::Watch { .. } => assert!(sent_once(), "one WATCH at a time"),
            ToManager::Counters => {
                assert!(sent_once(), "counters once, and once more for each loss");
            }
            ToManager::Reload => assert!(sent_once(), "one RELOAD at a time"),
            ToManager::Suspended { interface } => {
                assert_eq!(self.refused.take(), Some(interface), "one answer");
                assert!(
                    !self.dropping.contains(&interface),
                    "{interface} is withdrawn"
                );
            }
            _ => {}
        }
    }
}

struct Fuzz<'a> {
    script: Script<'a>,
    node: Node,
    /// `None` between the end of a session and the next one.
    session: Option<SessionModel>,
    welcomed: bool,
    /// The interfaces that the Manager of any session has granted.
    granted: BTreeSet<InterfaceId>,
}

impl Fuzz<'_> {
    /// Does one operation; `None` when the bytes are used up.
    fn step(&mut self) -> Option<()> {
        let operation = self.script.byte()?;
        match operation % 16 {
            0 => {
                let flags = self.script.byte()?;
                let datagram = Datagram {
                    bytes: self.script.bytes()?,
                    fds: &FD[..usize::from(flags & 3) % 3],
                    data_truncated: flags & 4 != 0,
                    control_truncated: flags & 8 != 0,
                };
                self.datagram(datagram);
            }
            1..=7 => {
                let frame = self.frame()?;
                let bytes = encode_to_node(&frame);
                let carries = matches!(frame, ToNode::Link { .. } | ToNode::Inspected { .. });
                self.datagram(Datagram {
                    fds: &FD[..usize::from(carries)],
                    ..Datagram::new(&bytes)
                });
            }
            8 | 9 => {
                let contract = self.script.contract()?;
                let declared = self.node.declare(contract);
                assert!(self.welcomed || declared.is_err());
                self.drain();
            }
            10 => {
                // A connection that was refused is closed for the next one.
                if self.node.handle(NOW, Input::Reconnected).is_ok() {
                    self.session = Some(SessionModel::default());
                }
                self.drain();
            }
            _ => {
                let input = self.input()?;
                self.feed(input);
            }
        }
        Some(())
    }

    fn input(&mut self) -> Option<Input<'static>> {
        let script = &mut self.script;
        Some(match script.byte()? % 12 {
            0 => Input::Withdraw {
                interface: script.interface()?,
            },
            1 => Input::Unlinked {
                interface: script.interface()?,
                link: script.link()?,
                code: script.code()?,
            },
            2 => Input::Query {
                after: Some(script.key()?),
            },
            3 => Input::Watch {
                after: script.number()?,
            },
            4 => Input::Counters,
            5 => Input::Inspect {
                node: script.node()?,
            },
            6 => {
                let (data, text) = script.schema()?;
                Input::Schema(SchemaText { data, text })
            }
            7 => Input::Describe {
                data: script.schema()?.0,
            },
            8 => Input::Greet(script.name()?),
            9 => Input::Eof,
            10 => Input::Reload,
            _ if script.byte()? > 250 => Input::Close(script.code()?),
            _ => Input::Counters,
        })
    }

    /// A legal frame.
    fn frame(&mut self) -> Option<ToNode> {
        let script = &mut self.script;
        Some(match script.byte()? % 17 {
            0 | 1 => ToNode::Welcome {
                version: u16::from(script.byte()? != u8::MAX),
                epoch: 1 + script.number()? % 2,
                node: script.node()?,
            },
            2 => ToNode::HelloRefused {
                reason: script.refusal()?,
            },
            3 | 4 => ToNode::Declared {
                interface: script.interface()?,
                matches: 1,
            },
            5 => ToNode::DeclareRefused {
                interface: script.interface()?,
                reason: script.refusal()?,
            },
            6..=8 => return self.link_frame(),
            9 => ToNode::Unlink {
                interface: script.interface()?,
                link: script.link()?,
                code: script.code()?,
            },
            10 => ToNode::Withdrawn {
                interface: script.interface()?,
            },
            11 => ToNode::Page(Page {
                revision: script.number()?,
                items: script.items()?,
                next: None,
            }),
            12 => ToNode::Goodbye {
                code: script.code()?,
            },
            13 => ToNode::Changes(Changes {
                revision: script.number()?,
                changes: Some(script.changes()?),
                more: false,
            }),
            14 => match script.byte()? % 2 {
                0 => ToNode::Inspected {
                    node: script.node()?,
                },
                _ => ToNode::NotInspected {
                    node: script.node()?,
                },
            },
            15 => {
                let (data, text) = script.schema()?;
                let text = Some(text);
                ToNode::Described { data, text }
            }
            _ => ToNode::Reloaded {
                outcome: ReloadOutcome::NoPolicy,
            },
        })
    }

    fn link_frame(&mut self) -> Option<ToNode> {
        let script = &mut self.script;
        let choice = script.byte()?;
        Some(ToNode::Link {
            interface: script.interface()?,
            link: script.link()?,
            key: LinkKey(3),
            version: u16::from(choice < 250),
            reliable: choice & 1 != 0,
            sealed: choice & 2 != 0,
            peer: LinkPeer {
                node: script.node()?,
                name: script.name()?,
                interface: script.interface()?,
                contract: script.contract()?,
            },
        })
    }

    fn datagram(&mut self, datagram: Datagram<'_>) {
        let before = self.node.end();
        let taken = self.node.handle(NOW, Input::Datagram(datagram));
        match taken {
            Ok(()) => {
                let frame = decode_to_node(&datagram).expect("nothing else is taken");
                if let Some(session) = &mut self.session {
                    session.taken(&frame, &mut self.granted);
                }
            }
            Err(error) => {
                let end = self
                    .node
                    .end()
                    .expect("only an ended session refuses frames");
                assert_eq!(error, Error::Ended(end));
                assert!(before.is_none_or(|first| first == end));
            }
        }
        self.drain();
    }

    fn feed(&mut self, input: Input<'static>) {
        let before = self.node.clone();
        let taken = self.node.handle(NOW, input);
        if taken.is_err() {
            assert_eq!(self.node, before, "what is not taken changes nothing");
        }
        self.drain();
    }

    fn drain(&mut self) {
        let outputs: Vec<Output> = core::iter::from_fn(|| self.node.poll()).collect();
        for output in outputs {
            let session = self.session.as_mut();
            let session = || session.expect("nothing is sent without a session");
            match output {
                Output::Transmit(bytes) => {
                    let frame = decode_to_manager(&Datagram::new(&bytes));
                    session().sent(&frame.expect("canonical"));
                }
                Output::TransmitCounters(bytes) => {
                    let frame = decode_to_manager(&Datagram {
                        fds: &FD[..1],
                        ..Datagram::new(&bytes)
                    });
                    session().sent(&frame.expect("canonical"));
                }
                Output::Welcomed { .. } => self.welcomed = true,
                Output::Ended(end) => {
                    assert_eq!(self.node.end(), Some(end));
                    self.session = None;
                }
                _ => {}
            }
        }
    }
}
