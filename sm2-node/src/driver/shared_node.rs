//! The state that all handles of a node share.

use std::io;
use std::mem;
use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use sm2_io::{Interest, Maker, SeqPacket, Waker};
use sm2_proto::node::Input;
use sm2_proto::{Farewell, InterfaceId, Name};

use super::background::BackgroundThread;
use super::control::Control;
use super::datagram::Incoming;
use super::event_sets::NodeSets;
use super::interface::ForControl;
use super::shared_interface::ControlSide;
use super::token::SESSION;
use crate::Shutdown;
use crate::quota::MappingQuota;

/// A node, as its handles share it. The last handle ends the node.
#[derive(Debug)]
pub(crate) struct SharedNode {
    pub(super) state: Arc<NodeState>,
    /// `None` if the calls of the program drive the node.
    background: Option<BackgroundThread>,
    /// The last field, so that the Manager is dropped after this node has closed its session.
    #[cfg(feature = "embedded-manager")]
    embedded: Option<sm2_manager::Background>,
}

/// The state of a node, which its handles share with its background thread.
#[derive(Debug)]
pub(crate) struct NodeState {
    pub(crate) sets: Arc<NodeSets>,
    pub(crate) name: Name,
    /// The timeout for an answer of the Manager.
    pub(crate) manager_timeout: Duration,
    /// The process that connected the node.
    maker: Maker,
    /// Signalled when the session changes, until [`drive_all`](Self::drive_all).
    pub(super) changed: Arc<Waker>,
    control: Mutex<Control>,
    /// Alive while the node has parameters.
    parameters: Mutex<Weak<()>>,
}

/// How a node is driven, and what it offers.
#[derive(Debug)]
pub(crate) struct Settings {
    /// The timeout for an answer of the Manager.
    pub(crate) manager_timeout: Duration,
    /// Whether links offer the ring lane.
    pub(crate) ring_lane: bool,
    /// Whether a thread of the node drives its control side.
    pub(crate) background: bool,
    /// The bytes that may be mapped for peers.
    pub(crate) mappings: MappingQuota,
    /// Ends the waits of the program's threads.
    pub(crate) shutdown: Option<Shutdown>,
}

impl SharedNode {
    /// Creates a node whose Manager is at the other end of `socket`. The node finds later Managers at `path`. Until
    /// [`start_background`](Self::start_background), calls drive all of it.
    pub(crate) fn new(
        socket: SeqPacket,
        path: PathBuf,
        name: Name,
        settings: Settings,
    ) -> io::Result<Self> {
        let sets = Arc::new(NodeSets::new(settings.background, settings.shutdown)?);
        sets.control.add(&socket, SESSION, Interest::READABLE)?;
        let Settings {
            manager_timeout,
            ring_lane,
            mappings,
            ..
        } = settings;
        let mut control = Control::new(socket, path, name.clone(), ring_lane, mappings, &sets)?;
        let changed = control.sleepers.enter()?;
        sets.add_waker(&changed)?;
        control.state_links();
        control.drain_session(Incoming::default(), &sets);
        Ok(Self {
            state: Arc::new(NodeState {
                sets,
                name,
                manager_timeout,
                maker: Maker::this_process(),
                changed,
                control: Mutex::new(control),
                parameters: Mutex::default(),
            }),
            background: None,
            #[cfg(feature = "embedded-manager")]
            embedded: None,
        })
    }

    /// Lets the caller declare the parameters of the node, as long as the result exists; `None` if another caller does.
    pub(crate) fn claim_parameters(&self) -> Option<Arc<()>> {
        let parameters = self.parameters.lock();
        let mut parameters = parameters.unwrap_or_else(PoisonError::into_inner);
        if parameters.upgrade().is_some() {
            return None;
        }
        let claim = Arc::new(());
        *parameters = Arc::downgrade(&claim);
        Some(claim)
    }

    /// The control side, as interfaces use it.
    pub(crate) fn control_side(&self) -> Arc<dyn ControlSide> {
        Arc::<NodeState>::clone(&self.state)
    }

    /// Starts the background thread, if the node is to have one.
    pub(crate) fn start_background(&mut self) -> io::Result<()> {
        if self.sets.has_background() {
            let state = Arc::clone(&self.state);
            let drive = move || state.drive_control();
            let thread = BackgroundThread::start(self.name.as_str(), &self.sets, drive)?;
            self.background = Some(thread);
        }
        Ok(())
    }

    /// Attaches a Manager that runs in this process, active or standby.
    #[cfg(feature = "embedded-manager")]
    pub(crate) fn with_manager(mut self, manager: Option<sm2_manager::Background>) -> Self {
        self.embedded = manager;
        self
    }
}

impl Deref for SharedNode {
    type Target = NodeState;

    #[inline]
    fn deref(&self) -> &NodeState {
        &self.state
    }
}

impl NodeState {
    /// Whether this process is a child, made by `fork(2)`, of the process that connected the node. Such a child has
    /// copies of the node's descriptors, but not its threads, and another thread may have held a lock.
    pub(crate) fn is_inherited(&self) -> bool {
        self.maker.is_parent()
    }

    /// Locks the control side. If another thread panicked under the lock, the state is still consistent: the only user
    /// code that runs under the lock is a `tracing` subscriber, which must not call this node.
    pub(crate) fn lock(&self) -> MutexGuard<'_, Control> {
        self.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the control side and drives it. Before that, gives back one part of the memory that no message needs.
    pub(crate) fn lock_driven(&self) -> MutexGuard<'_, Control> {
        let mut control = self.lock();
        if let Some(leftover) = control.leftovers.next(&self.sets) {
            drop(control);
            let rest = leftover.release_part();
            control = self.lock();
            control.leftovers.put_back(rest);
        }
        control.drive(&self.sets);
        control
    }

    /// Drives the control side. Returns whether the kernel had no memory for it.
    pub(super) fn drive_control(&self) -> bool {
        self.lock_driven().short_of_memory
    }
}

impl ControlSide for NodeState {
    fn drive(&self) -> bool {
        self.drive_control()
    }

    fn handle(&self, interface: InterfaceId, results: ForControl) {
        self.lock().handle(interface, results, &self.sets);
    }
}

impl Drop for SharedNode {
    fn drop(&mut self) {
        if self.is_inherited() {
            // The threads are those of the parent: they cannot be joined here.
            mem::forget(self.background.take());
            #[cfg(feature = "embedded-manager")]
            mem::forget(self.embedded.take());
            return;
        }
        // The thread ends first: it must not connect to a Manager again.
        self.background = None;
        let mut control = self.lock();
        control.session.tell(Input::Close(Farewell::Done.code()));
        control.drain_session(Incoming::default(), &self.sets);
    }
}
