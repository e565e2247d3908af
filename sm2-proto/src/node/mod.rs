//! A node's sessions with its Managers, from the node's side (SPEC sections 4.2, 4.3, 5 and 11).
//!
//! | to do | call |
//! | --- | --- |
//! | feed, drain, deadline | [`Machine`], and [`Node::declare`], which returns a number at once |
//! | inspect | [`Node::id`], [`Node::epoch`], [`Node::was_welcomed`] |
//! | inspect the phase | [`Node::is_ready`], [`Node::is_away`], [`Node::end`] |
//!
//! The machine never does I/O. The descriptor of a datagram stays with the driver, which closes
//! it unless the output that follows is [`Output::Linked`] or [`Output::Inspected`].
//!
//! # One machine, many sessions
//!
//! The end of a session ends no link: the driver keeps the links open. The machine goes on as well;
//! only [`Input::Close`] ends it. The order of calls:
//!
//! 1. [`Node::new`] on a new connection. The first output is the greeting.
//! 2. [`Output::Welcomed`]: interfaces can be declared from now on, at any time.
//! 3. [`Output::Ended`]: close the connection. The machine is *away*. Links stay, and
//!    [`Input::Unlinked`], [`Input::Withdraw`] and [`Node::declare`] stay legal.
//! 4. Connect again, when and as often as SM2-RES-001 allows, and feed [`Input::Reconnected`]. The
//!    machine greets. After WELCOME it declares its granted interfaces again, and claims the open
//!    links of those that are granted once more. [`Output::HelloRefused`] does not end the machine:
//!    feed [`Input::Greet`], or close the connection and feed [`Input::Reconnected`] once the next
//!    one is there.
//! 5. [`Output::Resumed`]: the new Manager knows all interfaces and links of the node.
//!
//! | state | what is legal there | leads to |
//! | --- | --- | --- |
//! | greeting | nothing but to wait; after the first WELCOME as *away* | WELCOME: ready, or declaring again |
//! | refused | [`Input::Greet`], [`Input::Reconnected`]; else as *greeting* | greeting |
//! | declaring again | every request; a new declaration waits | last answer: CLAIM for each link, CLAIMED, ready |
//! | ready | every request | end of the session: away |
//! | away | [`Node::declare`], [`Input::Withdraw`], [`Input::Unlinked`], [`Input::Reconnected`] | greeting |
//! | ended | nothing | |
//!
//! [`Input::MaxLinks`] is legal in every state but the last. So is [`Input::Close`], which leads
//! there. Each [`Input::Withdraw`] that is taken is answered with one [`Output::Withdrawn`], at the
//! latest at the end of the
//! session; only [`Input::Close`] drops that answer. A declaration without an answer is sent again
//! in the next session. All other requests without an answer are forgotten with the session.

mod event;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod interface;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod receive;
mod requests;
mod resume;

use alloc::collections::VecDeque;

pub use self::event::{End, Error, Input, Misuse, Output};
use self::{
    interface::Withdrawal,
    phase::{Interfaces, OpenSession, Phase},
    requests::is_text_of,
};
use crate::{
    Code, Contract, Instant, InterfaceId, LinkId, Machine, Name, NodeId,
    control::{SchemaText, ToManager, encode_to_manager},
    machine::debug_assert_drained,
};

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Node {
    name: Name,
    /// The number of ends of links that this node can have at a time, if the driver stated one.
    max_links: Option<u32>,
    phase: Phase,
    outputs: VecDeque<Output>,
}

impl Node {
    /// A node of this name. The first output is the greeting.
    //= SM2-SES-001
    #[must_use]
    pub fn new(name: Name) -> Self {
        let mut node = Self {
            name,
            max_links: None,
            phase: Phase::Greeting(None),
            outputs: VecDeque::new(),
        };
        node.greet();
        node
    }

    /// The number of this node in its session; `None` before WELCOME and after the session.
    #[must_use]
    pub const fn id(&self) -> Option<NodeId> {
        match self.phase.session() {
            Some(session) => Some(session.node),
            None => None,
        }
    }

    /// The epoch of the session's Manager (SM2-SES-007); `None` before WELCOME and after the session.
    #[must_use]
    pub const fn epoch(&self) -> Option<u64> {
        match self.phase.session() {
            Some(session) => Some(session.epoch),
            None => None,
        }
    }

    /// Whether the Manager has welcomed this node and knows all its interfaces and links.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        matches!(self.phase, Phase::Ready(..))
    }

    /// Whether any Manager has ever welcomed this node. False after [`Input::Close`].
    #[must_use]
    pub const fn was_welcomed(&self) -> bool {
        self.phase.was_welcomed()
    }

    /// Whether the session is over and the machine waits for [`Input::Reconnected`].
    #[must_use]
    pub const fn is_away(&self) -> bool {
        matches!(self.phase, Phase::Away(..))
    }

    /// The reason why the session is over, if it is. The reason is final unless
    /// [`Node::is_away`].
    #[must_use]
    pub const fn end(&self) -> Option<End> {
        match self.phase {
            Phase::Away(end, _) | Phase::Ended(end) => Some(end),
            Phase::Greeting(_) | Phase::Refused(_) | Phase::Resuming(_) | Phase::Ready(_) => None,
        }
    }

    /// Declares an interface and allots its number. Without a session, or while one is resumed,
    /// DECLARE goes out after CLAIMED.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotReady`] before the first WELCOME, [`Misuse::Qos`] for what
    /// SM2-FRM-003 does not allow, [`Misuse::NumbersSpent`] when no number is left,
    /// [`Error::Ended`] after [`Input::Close`].
    //= SM2-IFC-001, SM2-RES-002
    pub fn declare(&mut self, contract: Contract) -> Result<InterfaceId, Error> {
        let interfaces = self.interfaces()?;
        contract.check_qos().map_err(Misuse::from)?;
        let interface = interfaces.allot(contract)?;
        if let Phase::Ready(session) = &mut self.phase
            && let Some(declare) = session.declare(interface)
        {
            self.send(&declare);
        }
        Ok(interface)
    }
}

impl Machine for Node {
    type Input<'a> = Input<'a>;
    type Output = Output;
    type End = End;
    type Misuse = Misuse;

    /// Takes one input. A violation by the Manager ends the session: this call returns it, and so
    /// does every later call that needs a session, until [`Input::Reconnected`] begins the next.
    ///
    /// # Errors
    ///
    /// [`Error::Misuse`] if the input is not legal in this state: nothing has changed.
    /// [`Error::Ended`] if the session or the machine has ended: see [`Node::is_away`].
    fn handle(&mut self, _now: Instant, input: Input<'_>) -> Result<(), Error> {
        match input {
            Input::Datagram(datagram) => {
                debug_assert_drained(&self.outputs);
                self.check_session()?;
                self.receive(&datagram).map_err(Error::Ended)?;
            }
            Input::Eof => {
                self.check_session()?;
                self.go_away(End::Eof);
            }
            Input::Greet(name) => self.greet_again(name)?,
            Input::Reconnected => self.reconnected()?,
            Input::Withdraw { interface } => self.withdraw(interface)?,
            Input::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked(interface, link, code)?,
            Input::Query { after } => {
                self.session()?.requests.query();
                self.send(&ToManager::Query { after });
            }
            Input::Watch { after } => {
                self.session()?.requests.watch()?;
                self.send(&ToManager::Watch { after });
            }
            Input::Counters => {
                self.session()?.requests.counters()?;
                self.send_counters();
            }
            Input::Inspect { node } => {
                self.session()?.requests.inspect(node);
                self.send(&ToManager::Inspect { node });
            }
            Input::MaxLinks(max_links) => self.set_max_links(max_links)?,
            Input::Schema(SchemaText { data, text }) => {
                self.session()?;
                if !is_text_of(&text, &data) {
                    return Err(Misuse::Schema.into());
                }
                self.send(&ToManager::Schema(SchemaText { data, text }));
            }
            Input::Describe { data } => {
                self.session()?.requests.describe(data.clone());
                self.send(&ToManager::Describe { data });
            }
            Input::Reload => {
                self.session()?.requests.reload()?;
                self.send(&ToManager::Reload);
            }
            Input::Close(code) => self.close(code)?,
        }
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Always `None`: the machine has no timer in version 1.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}

impl Node {
    /// Fails if there is no connection with a Manager.
    fn check_session(&self) -> Result<(), Error> {
        self.end().map_or(Ok(()), |end| Err(Error::Ended(end)))
    }

    /// The session, if the Manager takes requests.
    fn session(&mut self) -> Result<&mut OpenSession, Error> {
        self.check_session()?;
        self.phase.session_mut().ok_or(Misuse::NotReady.into())
    }

    /// The interfaces, if any Manager has ever welcomed this node.
    fn interfaces(&mut self) -> Result<&mut Interfaces, Error> {
        if let Phase::Ended(end) = self.phase {
            return Err(Error::Ended(end));
        }
        self.phase.interfaces_mut().ok_or(Misuse::NotReady.into())
    }

    //= SM2-SES-003, SM2-RES-001
    fn greet_again(&mut self, name: Name) -> Result<(), Error> {
        self.check_session()?;
        if !matches!(self.phase, Phase::Refused(_)) {
            return Err(Misuse::NotRefused.into());
        }
        if self.was_welcomed() && self.name != name {
            return Err(Misuse::OtherName.into());
        }
        self.name = name;
        self.greet();
        Ok(())
    }

    fn withdraw(&mut self, interface: InterfaceId) -> Result<(), Error> {
        let interfaces = &mut self.interfaces()?.by_id;
        let ours = interfaces.get_mut(&interface);
        match ours.ok_or(Misuse::NotLive)?.withdraw()? {
            Withdrawal::Send => self.send(&ToManager::Withdraw { interface }),
            Withdrawal::Wait => {}
            Withdrawal::Forget => {
                interfaces.remove(&interface);
                self.outputs.push_back(Output::Withdrawn { interface });
            }
        }
        Ok(())
    }

    //= SM2-LNK-009
    fn unlinked(&mut self, interface: InterfaceId, link: LinkId, code: Code) -> Result<(), Error> {
        if let Phase::Ended(end) = self.phase {
            return Err(Error::Ended(end));
        }
        let interfaces = self.phase.interfaces_mut();
        let ours = interfaces.and_then(|it| it.by_id.get_mut(&interface));
        if ours.is_some_and(|interface| interface.close_link(link)) {
            self.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            });
        }
        Ok(())
    }

    //= SM2-LNK-007
    fn set_max_links(&mut self, max_links: u32) -> Result<(), Error> {
        if let Phase::Ended(end) = self.phase {
            return Err(Error::Ended(end));
        }
        self.max_links = Some(max_links);
        if self.phase.session().is_some() {
            self.send(&ToManager::MaxLinks { max_links });
        }
        Ok(())
    }

    fn close(&mut self, code: Code) -> Result<(), Error> {
        match self.phase {
            Phase::Ended(end) => return Err(Error::Ended(end)),
            Phase::Away(..) => {}
            Phase::Greeting(_) | Phase::Refused(_) | Phase::Resuming(_) | Phase::Ready(_) => {
                self.send(&ToManager::Goodbye { code });
            }
        }
        self.finish(End::Local(code));
        Ok(())
    }

    fn send_counters(&mut self) {
        let frame = encode_to_manager(&ToManager::Counters);
        self.outputs.push_back(Output::TransmitCounters(frame));
    }

    fn send_all(&mut self, frames: &[ToManager]) {
        for frame in frames {
            self.send(frame);
        }
    }

    fn send(&mut self, frame: &ToManager) {
        self.outputs
            .push_back(Output::Transmit(encode_to_manager(frame)));
    }
}
