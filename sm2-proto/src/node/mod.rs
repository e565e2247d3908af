//! A node's session with its Manager, as the node sees it (SPEC section 4.2, 4.3, 5).
//!
//! | to do | call |
//! | --- | --- |
//! | feed | [`Node::declare`], [`Node::handle`] |
//! | drain | [`Node::poll`] until it gives nothing, after every feed |
//! | deadline | [`Node::deadline`]: a session has no timer in version 1 |
//! | inspect | [`Node::id`], [`Node::is_ready`], [`Node::end`] |
//!
//! The machine never does I/O. A LINK's descriptor stays with the driver,
//! which closes it unless the output that follows is [`Output::Linked`].
//! The end of the session ends no link: that is the driver's to honour.

mod interface;

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};

use self::interface::{Answer, Interface};
use crate::{
    Code, Contract, Datagram, Instant, InterfaceId, LinkId, Name, NodeId, QosError, Refusal,
    VERSION, Violation,
    control::{Cursor, Item, Peer, ToManager, ToNode, decode_to_node, encode_to_manager},
};

/// What happens to a node.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The Manager sent a datagram.
    Datagram(Datagram<'a>),
    /// The Manager's end of the connection is gone.
    Eof,
    /// After [`Output::HelloRefused`]: greet again, under this name.
    Greet(Name),
    /// Drop a live interface, and all its links with it.
    Withdraw {
        /// Which.
        interface: InterfaceId,
    },
    /// The machine of a link has ended. Harmless if the Manager said so first.
    Unlinked {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// Ask for a page of the domain's state.
    Query {
        /// The last item that is known.
        after: Option<Cursor>,
    },
    /// End the session.
    Close(Code),
}

/// What the driver has to do, or to know.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send these bytes as one datagram.
    Transmit(Vec<u8>),
    /// The session is ready.
    Welcomed {
        /// Our number.
        node: NodeId,
        /// The Manager's incarnation.
        epoch: u64,
    },
    /// The Manager did not grant the greeting: greet again or close.
    HelloRefused(Refusal),
    /// The interface is live.
    Declared {
        /// Which.
        interface: InterfaceId,
        /// How many interfaces it matched.
        matches: u32,
    },
    /// The interface was not granted; its number is spent.
    DeclareRefused {
        /// Which.
        interface: InterfaceId,
        /// Why.
        reason: Refusal,
    },
    /// A link: its socket is the descriptor of the datagram just handled.
    Linked {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// The version to speak on it.
        version: u16,
        /// Whether nothing on it may be displaced.
        reliable: bool,
        /// Whether every message on it is inline or sealed.
        sealed: bool,
        /// The other side.
        peer: Peer,
    },
    /// The Manager ended a link: end its machine with this code.
    Unlink {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// The interface is gone at the Manager too.
    Withdrawn {
        /// Which.
        interface: InterfaceId,
    },
    /// A page of the domain's state.
    Page {
        /// Of which revision.
        revision: u64,
        /// Nodes and interfaces in ascending order.
        items: Vec<Item>,
        /// Where to go on, if more follow.
        next: Option<Cursor>,
    },
    /// The session is over: close the connection. Always the last output.
    Ended(End),
}

/// Why a session is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// We closed it.
    #[error("closed by this node ({0})")]
    Local(Code),
    /// The Manager said goodbye.
    #[error("the Manager hung up: {0}")]
    Peer(Code),
    /// The Manager's end is gone without a word.
    #[error("the Manager is gone")]
    Eof,
    /// The Manager broke SPEC.
    #[error("the Manager broke the protocol: {0}")]
    Violation(Violation),
}

/// Why an input was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Error {
    /// The session is over.
    #[error(transparent)]
    Ended(#[from] End),
    /// The caller did what this state does not allow.
    #[error(transparent)]
    Misuse(#[from] Misuse),
}

/// What a caller did wrong. Nothing was sent and nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// The session is not ready.
    #[error("the Manager has not welcomed this node yet")]
    NotReady,
    /// A greeting is legal only after a refusal.
    #[error("the Manager has not refused a greeting")]
    NotRefused,
    /// The interface is not live.
    #[error("no live interface has that number")]
    NotLive,
    /// The contract is out of range.
    #[error("{field} is {value}, which is out of range (SM2-FRM-003)")]
    Qos {
        /// Which value.
        field: &'static str,
        /// What it is.
        value: u16,
    },
}

impl From<QosError> for Error {
    fn from(QosError { field, value, .. }: QosError) -> Self {
        Misuse::Qos { field, value }.into()
    }
}

/// How far the session has come: the rows of the table in SPEC section 4.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Phase {
    Greeting,
    Refused,
    Ready(NodeId, u64),
    Ended(End),
}

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Node {
    phase: Phase,
    interfaces: BTreeMap<InterfaceId, Interface>,
    /// Declared and not answered yet, oldest first.
    declaring: VecDeque<InterfaceId>,
    last_interface: u64,
    /// Queries without their page.
    queries: u64,
    outputs: VecDeque<Output>,
}

impl Node {
    /// A session under `name`. The first output is the greeting.
    //= SM2-SES-001
    #[must_use]
    pub fn new(name: Name) -> Self {
        let mut node = Self {
            phase: Phase::Greeting,
            interfaces: BTreeMap::new(),
            declaring: VecDeque::new(),
            last_interface: 0,
            queries: 0,
            outputs: VecDeque::new(),
        };
        node.greet(name);
        node
    }

    /// Our number, once welcomed and as long as the session lives.
    #[must_use]
    pub const fn id(&self) -> Option<NodeId> {
        match self.phase {
            Phase::Ready(node, _) => Some(node),
            _ => None,
        }
    }

    /// The Manager's incarnation, once welcomed and as long as the session lives.
    #[must_use]
    pub const fn epoch(&self) -> Option<u64> {
        match self.phase {
            Phase::Ready(_, epoch) => Some(epoch),
            _ => None,
        }
    }

    /// Whether interfaces can be declared.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        matches!(self.phase, Phase::Ready(..))
    }

    /// Why the session is over, if it is.
    #[must_use]
    pub const fn end(&self) -> Option<End> {
        match self.phase {
            Phase::Ended(end) => Some(end),
            _ => None,
        }
    }

    /// When the machine wants to be called again: never, in version 1.
    #[must_use]
    pub const fn deadline(&self) -> Option<Instant> {
        None
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Declares an interface and allots its number.
    //= SM2-IFC-001
    pub fn declare(&mut self, contract: Contract) -> Result<InterfaceId, Error> {
        self.check_ready()?;
        contract.check_qos()?;
        self.last_interface += 1;
        let interface = InterfaceId(self.last_interface);
        self.interfaces
            .insert(interface, Interface::new(contract.clone()));
        self.declaring.push_back(interface);
        self.send(&ToManager::Declare {
            interface,
            contract,
        });
        Ok(interface)
    }

    /// Takes one input. A violation by the Manager ends the session: it is
    /// returned here once, and by every later call.
    pub fn handle(&mut self, _now: Instant, input: Input<'_>) -> Result<(), Error> {
        if let Phase::Ended(end) = self.phase {
            return Err(end.into());
        }
        match input {
            Input::Datagram(datagram) => self.receive(&datagram)?,
            Input::Eof => self.finish(End::Eof),
            Input::Greet(name) => {
                if self.phase != Phase::Refused {
                    return Err(Misuse::NotRefused.into());
                }
                self.phase = Phase::Greeting;
                self.greet(name);
            }
            Input::Withdraw { interface } => self.withdraw(interface)?,
            Input::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked(interface, link, code),
            Input::Query { after } => {
                self.check_ready()?;
                self.queries += 1;
                self.send(&ToManager::Query { after });
            }
            Input::Close(code) => {
                self.send(&ToManager::Goodbye { code });
                self.finish(End::Local(code));
            }
        }
        Ok(())
    }

    fn check_ready(&self) -> Result<(), Error> {
        match self.phase {
            Phase::Ready(..) => Ok(()),
            Phase::Ended(end) => Err(end.into()),
            Phase::Greeting | Phase::Refused => Err(Misuse::NotReady.into()),
        }
    }

    fn greet(&mut self, name: Name) {
        self.send(&ToManager::Hello {
            min_version: VERSION,
            max_version: VERSION,
            name,
        });
    }

    fn withdraw(&mut self, interface: InterfaceId) -> Result<(), Error> {
        self.check_ready()?;
        let state = self.interfaces.get_mut(&interface).ok_or(Misuse::NotLive)?;
        state.drop_it().ok_or(Misuse::NotLive)?;
        self.send(&ToManager::Withdraw { interface });
        Ok(())
    }

    //= SM2-LNK-004
    fn unlinked(&mut self, interface: InterfaceId, link: LinkId, code: Code) {
        let ours = self.interfaces.get_mut(&interface);
        if ours.is_some_and(|interface| interface.close_link(link)) {
            self.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            });
        }
    }

    //= SM2-NOD-001
    fn receive(&mut self, datagram: &Datagram<'_>) -> Result<(), End> {
        let frame = decode_to_node(datagram).and_then(|frame| self.step(frame));
        frame.map_err(|violation| {
            self.send(&ToManager::Goodbye {
                code: violation.code(),
            });
            let end = End::Violation(violation);
            self.finish(end);
            end
        })
    }

    /// One frame in the session's phase: the table of SPEC section 4.2.
    fn step(&mut self, frame: ToNode) -> Result<(), Violation> {
        match (self.phase, frame) {
            (Phase::Ended(_), _) => Ok(()),
            (_, ToNode::Goodbye { code }) => {
                self.finish(End::Peer(code));
                Ok(())
            }
            (
                Phase::Greeting,
                ToNode::Welcome {
                    version,
                    epoch,
                    node,
                },
            ) => self.welcome(version, epoch, node),
            (Phase::Greeting, ToNode::HelloRefused { reason }) => {
                self.phase = Phase::Refused;
                self.outputs.push_back(Output::HelloRefused(reason));
                Ok(())
            }
            (_, ToNode::Welcome { .. } | ToNode::HelloRefused { .. }) => {
                Err(Violation::UnexpectedWelcome)
            }
            (Phase::Greeting | Phase::Refused, _) => Err(Violation::ExpectedWelcome),
            (Phase::Ready(..), frame) => self.step_ready(frame),
        }
    }

    //= SM2-NOD-002
    fn welcome(&mut self, version: u16, epoch: u64, node: NodeId) -> Result<(), Violation> {
        if version != VERSION {
            return Err(Violation::BadVersion);
        }
        self.phase = Phase::Ready(node, epoch);
        self.outputs.push_back(Output::Welcomed { node, epoch });
        Ok(())
    }

    fn step_ready(&mut self, frame: ToNode) -> Result<(), Violation> {
        match frame {
            ToNode::Declared { interface, matches } => {
                self.answered(interface)?.declared();
                self.outputs
                    .push_back(Output::Declared { interface, matches });
            }
            ToNode::DeclareRefused { interface, reason } => {
                self.answered(interface)?;
                self.interfaces.remove(&interface);
                self.outputs
                    .push_back(Output::DeclareRefused { interface, reason });
            }
            ToNode::Link {
                interface,
                link,
                version,
                reliable,
                sealed,
                peer,
            } => {
                let ours = self.interface(interface)?;
                if version != VERSION {
                    return Err(Violation::BadLink);
                }
                if ours.link(link, reliable, sealed, &peer.contract)? {
                    let linked = Output::Linked {
                        interface,
                        link,
                        version,
                        reliable,
                        sealed,
                        peer,
                    };
                    self.outputs.push_back(linked);
                }
            }
            ToNode::Unlink {
                interface,
                link,
                code,
            } => self.unlink(interface, link, code)?,
            ToNode::Withdrawn { interface } => {
                self.interface(interface)?.withdrawn()?;
                self.interfaces.remove(&interface);
                self.outputs.push_back(Output::Withdrawn { interface });
            }
            ToNode::Page {
                revision,
                items,
                next,
            } => {
                self.queries = self
                    .queries
                    .checked_sub(1)
                    .ok_or(Violation::UnexpectedPage)?;
                self.outputs.push_back(Output::Page {
                    revision,
                    items,
                    next,
                });
            }
            ToNode::Welcome { .. } | ToNode::HelloRefused { .. } | ToNode::Goodbye { .. } => {
                return Err(Violation::UnexpectedWelcome);
            }
        }
        Ok(())
    }

    //= SM2-LNK-003
    fn unlink(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        code: Code,
    ) -> Result<(), Violation> {
        match self.interface(interface)?.unlink(link)? {
            Answer::Unlinked => {
                self.send(&ToManager::Unlinked {
                    interface,
                    link,
                    code,
                });
                self.outputs.push_back(Output::Unlink {
                    interface,
                    link,
                    code,
                });
            }
            Answer::Nothing => {}
        }
        Ok(())
    }

    //= SM2-FRM-004
    fn interface(&mut self, interface: InterfaceId) -> Result<&mut Interface, Violation> {
        self.interfaces
            .get_mut(&interface)
            .ok_or(Violation::UnknownInterface)
    }

    /// The interface that the Manager has to answer next.
    //= SM2-IFC-002
    fn answered(&mut self, interface: InterfaceId) -> Result<&mut Interface, Violation> {
        if self.declaring.front() != Some(&interface) {
            return Err(Violation::UnknownInterface);
        }
        self.declaring.pop_front();
        self.interface(interface)
    }

    fn send(&mut self, frame: &ToManager) {
        self.outputs
            .push_back(Output::Transmit(encode_to_manager(frame)));
    }

    fn finish(&mut self, end: End) {
        self.phase = Phase::Ended(end);
        self.interfaces.clear();
        self.declaring.clear();
        self.outputs.push_back(Output::Ended(end));
    }
}
