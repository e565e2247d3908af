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

mod event;
mod interface;

use alloc::collections::{BTreeMap, VecDeque};

pub use self::event::{End, Error, Input, Misuse, Output};
use self::interface::{Answer, Interface};
use crate::{
    Code, Contract, Datagram, Instant, InterfaceId, LinkId, Name, NodeId, Terms, VERSION,
    Violation,
    control::{Peer, ToManager, ToNode, decode_to_node, encode_to_manager},
};

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
        if let Input::Datagram(_) = input {
            let pending = |it: &Output| matches!(it, Output::Linked { .. });
            debug_assert!(
                !self.outputs.iter().any(pending),
                "the descriptor of a link goes with the datagram before: poll first"
            );
        }
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
        let ours = self.interfaces.get_mut(&interface);
        ours.ok_or(Misuse::NotLive)?.withdraw()?;
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
        let step = decode_to_node(datagram).and_then(|frame| self.step(frame));
        match step {
            Ok(output) => {
                self.outputs.extend(output);
                Ok(())
            }
            Err(violation) => {
                let code = violation.code();
                self.send(&ToManager::Goodbye { code });
                let end = End::Violation(violation);
                self.finish(end);
                Err(end)
            }
        }
    }

    /// One frame in the session's phase, and what the driver has to know of it:
    /// the table of SPEC section 4.2.
    fn step(&mut self, frame: ToNode) -> Result<Option<Output>, Violation> {
        match (self.phase, frame) {
            (Phase::Ended(_), _) => Ok(None),
            (_, ToNode::Goodbye { code }) => {
                self.finish(End::Peer(code));
                Ok(None)
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
                Ok(Some(Output::HelloRefused(reason)))
            }
            (_, ToNode::Welcome { .. } | ToNode::HelloRefused { .. }) => {
                Err(Violation::UnexpectedWelcome)
            }
            (Phase::Greeting | Phase::Refused, _) => Err(Violation::ExpectedWelcome),
            (Phase::Ready(..), ToNode::Declared { interface, matches }) => {
                self.answered(interface)?.declared();
                Ok(Some(Output::Declared { interface, matches }))
            }
            (Phase::Ready(..), ToNode::DeclareRefused { interface, reason }) => {
                self.answered(interface)?;
                self.interfaces.remove(&interface);
                Ok(Some(Output::DeclareRefused { interface, reason }))
            }
            (
                Phase::Ready(..),
                ToNode::Link {
                    interface,
                    link,
                    version,
                    reliable,
                    sealed,
                    peer,
                },
            ) => self.link(interface, link, version, Terms { reliable, sealed }, peer),
            (
                Phase::Ready(..),
                ToNode::Unlink {
                    interface,
                    link,
                    code,
                },
            ) => self.unlink(interface, link, code),
            (Phase::Ready(..), ToNode::Withdrawn { interface }) => {
                self.interface(interface)?.withdrawn()?;
                self.interfaces.remove(&interface);
                Ok(Some(Output::Withdrawn { interface }))
            }
            (
                Phase::Ready(..),
                ToNode::Page {
                    revision,
                    items,
                    next,
                },
            ) => {
                let queries = self.queries.checked_sub(1);
                self.queries = queries.ok_or(Violation::UnexpectedPage)?;
                Ok(Some(Output::Page {
                    revision,
                    items,
                    next,
                }))
            }
        }
    }

    //= SM2-NOD-002
    fn welcome(
        &mut self,
        version: u16,
        epoch: u64,
        node: NodeId,
    ) -> Result<Option<Output>, Violation> {
        if version != VERSION {
            return Err(Violation::BadVersion);
        }
        self.phase = Phase::Ready(node, epoch);
        Ok(Some(Output::Welcomed { node, epoch }))
    }

    fn link(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        version: u16,
        terms: Terms,
        peer: Peer,
    ) -> Result<Option<Output>, Violation> {
        let ours = self.interface(interface)?;
        if !ours.link(link, version, terms, &peer.contract)? {
            return Ok(None);
        }
        let Terms { reliable, sealed } = terms;
        Ok(Some(Output::Linked {
            interface,
            link,
            version,
            reliable,
            sealed,
            peer,
        }))
    }

    //= SM2-LNK-003
    fn unlink(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        code: Code,
    ) -> Result<Option<Output>, Violation> {
        match self.interface(interface)?.unlink(link)? {
            Answer::Nothing => Ok(None),
            Answer::Unlinked => {
                self.send(&ToManager::Unlinked {
                    interface,
                    link,
                    code,
                });
                Ok(Some(Output::Unlink {
                    interface,
                    link,
                    code,
                }))
            }
        }
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
