//! The requests of handles to the session, and what they ask about it.

use std::io;
use std::sync::Arc;

use sm2_proto::control::SchemaText;
use sm2_proto::link::MaxLen;
use sm2_proto::node::{self, End, Input};
use sm2_proto::{Contract, InterfaceId, NodeId, Period, Refusal, TypeId};

use crate::driver::control::Control;
use crate::driver::datagram::Incoming;
use crate::driver::event_sets::{LinkSets, NodeSets};
use crate::driver::interface::{DeclaredInterface, State};
use crate::driver::outbox::PoolLimit;
use crate::driver::shared_interface::{ControlSide, SharedInterface};

/// Why an interface was not declared.
#[derive(Debug)]
pub(crate) enum NotDeclared {
    /// The session does not accept the declaration.
    Session(node::Error),
    /// The system refuses the set of the interface, or the timer of its deadline and lease.
    Sets(io::Error),
}

impl Control {
    /// The reason why no Manager knows all interfaces of this node, if there is one.
    pub(crate) const fn away(&self) -> Option<End> {
        self.session.away
    }

    /// The reason why the last greeting was refused, if it was.
    pub(crate) const fn greeting_refusal(&self) -> Option<&Refusal> {
        self.session.refused.as_ref()
    }

    /// Whether this node is connected to a Manager that knows all its interfaces and links.
    pub(crate) const fn is_connected(&self) -> bool {
        self.session.is_ready()
    }

    pub(crate) const fn node_id(&self) -> Option<NodeId> {
        self.session.id()
    }

    pub(crate) const fn epoch(&self) -> Option<u64> {
        self.session.epoch()
    }

    /// Whether the connected Manager has granted this interface.
    pub(crate) fn is_registered(&self, id: InterfaceId) -> bool {
        let interface = self.interfaces.get(&id);
        self.is_connected() && interface.is_some_and(|it| it.is_granted())
    }

    /// Declares an interface. DECLARE is sent as soon as a Manager is connected.
    pub(crate) fn declare(
        &mut self,
        contract: Contract,
        pool_limit: PoolLimit,
        max_len: MaxLen,
        control: Arc<dyn ControlSide>,
        sets: &Arc<NodeSets>,
    ) -> Result<Arc<SharedInterface>, NotDeclared> {
        if contract.deadline() != Period::NONE || contract.lease() != Period::NONE {
            (self.qos_timer.prepare(sets)).map_err(NotDeclared::Sets)?;
        }
        let declared = self.session.declare(contract.clone());
        let id = declared.map_err(NotDeclared::Session)?;
        let links = LinkSets::new(sets, id).map_err(|error| {
            self.session.tell(Input::Withdraw { interface: id });
            self.drain_session(Incoming::default(), sets);
            NotDeclared::Sets(error)
        })?;
        if self.counting.start() {
            self.session.tell(Input::Counters);
        }
        let entry = self.counting.allocate(id, None);
        let interface = DeclaredInterface::new(contract, pool_limit, max_len, entry);
        let interface = Arc::new(SharedInterface::new(
            id, &self.name, control, links, interface,
        ));
        self.interfaces.insert(id, Arc::clone(&interface));
        if let Some(results) = interface.ask_for_tick() {
            self.handle(id, results, sets);
        }
        self.drain_session(Incoming::default(), sets);
        Ok(interface)
    }

    /// The progress of a declaration.
    pub(crate) fn declared(&self, id: InterfaceId) -> Option<State> {
        self.interfaces.get(&id).map(|it| it.state())
    }

    /// Registers the schema text of a type with this Manager and all later ones. The text must have
    /// the type's hash.
    //= SM2-SCH-001
    pub(crate) fn register_schema(&mut self, data: TypeId, text: String, sets: &NodeSets) {
        if self.schemas.get(&data) == Some(&text) {
            return;
        }
        self.schemas.insert(data.clone(), text.clone());
        self.session.tell(Input::Schema(SchemaText { data, text }));
        self.drain_session(Incoming::default(), sets);
    }

    /// Closes the links of an interface and withdraws the interface.
    pub(crate) fn withdraw(&mut self, id: InterfaceId, sets: &NodeSets) {
        let tokens = self.with_interface(id, sets, |interface, context| {
            interface.close(context);
            interface.links.tokens_of(|_| true)
        });
        for token in tokens.unwrap_or_default() {
            self.routes.remove(&token);
        }
        self.interfaces.remove(&id);
        self.session.tell(Input::Withdraw { interface: id });
        self.drain_session(Incoming::default(), sets);
        self.sleepers.wake();
    }
}
