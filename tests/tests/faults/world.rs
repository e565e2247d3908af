//! A domain in this process, with a fault on the thread of its nodes, of its Manager, or of gateways.

use std::{
    collections::BTreeMap,
    error::Error,
    path::PathBuf,
    sync::mpsc,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use sm2_io::fault::{Call, Fault, Injector, Installed};
use sm2_manager::{Manager, Options, Outcome, Stopper};
use sm2_node::Node;
use sm2_test_support::SOON;

/// The thread whose calls fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Nodes,
    Manager,
    Gateways,
}

pub(crate) struct World {
    folder: tempfile::TempDir,
    side: Side,
    faults: Injector,
    manager: Option<Running>,
    _installed: Option<Installed>,
    serial: u64,
}

struct Running {
    stopper: Stopper,
    thread: JoinHandle<Outcome>,
}

impl World {
    /// Starts a domain. The faults of the nodes begin after the Manager has started.
    pub(crate) fn start(side: Side, fault: Option<Fault>) -> Self {
        super::accusations::collect();
        let faults = Injector::counting();
        faults.set(fault);
        let mut world = Self {
            folder: tempfile::tempdir().unwrap(),
            side,
            manager: None,
            _installed: None,
            serial: 0,
            faults,
        };
        world.start_manager();
        world._installed = (side == Side::Nodes).then(|| world.faults.install());
        world
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.path("test.sock")
    }

    /// The path of a file of this scenario.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Makes the calls of the scenario fail on the threads that install it.
    pub(crate) fn injector(&self) -> Injector {
        self.faults.clone()
    }

    pub(crate) fn start_manager(&mut self) {
        assert!(self.manager.is_none());
        let path = self.socket();
        let injector = (self.side == Side::Manager).then(|| self.faults.clone());
        let (started, stopper) = mpsc::channel();
        let thread = thread::spawn(move || {
            let _installed = injector.map(|it| it.install());
            let manager = patient("a Manager", || Manager::bind(&path, Options::default()));
            started.send(manager.stopper()).unwrap();
            manager.run().unwrap()
        });
        let stopper = stopper.recv_timeout(SOON).unwrap();
        self.manager = Some(Running { stopper, thread });
    }

    pub(crate) fn stop_manager(&mut self) {
        let Running { stopper, thread } = self.manager.take().unwrap();
        stopper.stop();
        assert!(matches!(thread.join(), Ok(Outcome::Stopped)));
    }

    /// A node, with or without the ring lane.
    pub(crate) fn node(&self, name: &str, ring: bool) -> Node {
        patient(name, || {
            let builder = Node::builder(name).socket(self.socket());
            builder.ring_lane(ring).connect()
        })
    }

    /// A number that no other message of the scenario has.
    pub(crate) fn next_serial(&mut self) -> u64 {
        self.serial += 1;
        self.serial
    }

    /// Ends the domain. Returns how often each call was made by the side with the fault.
    pub(crate) fn end(mut self) -> BTreeMap<Call, u64> {
        self.stop_manager();
        self.faults.counts()
    }
}

impl Drop for World {
    fn drop(&mut self) {
        // After a panic of the scenario.
        if let Some(Running { stopper, thread }) = self.manager.take() {
            stopper.stop();
            let _ = thread.join();
        }
    }
}

/// Tries until it succeeds, as a program does.
#[track_caller]
pub(crate) fn patient<T, E: Error>(what: &str, mut attempt: impl FnMut() -> Result<T, E>) -> T {
    let end = Instant::now() + SOON;
    loop {
        match attempt() {
            Ok(done) => return done,
            Err(error) => {
                assert!(
                    !error.to_string().is_empty(),
                    "{what}: an error without a text"
                );
                assert!(Instant::now() < end, "{what}: {error}");
            }
        }
        thread::sleep(Duration::from_millis(1));
    }
}
