//! A domain, a router of Zenoh, and bridges between them.

use std::fs;
use std::net::TcpListener;
use std::ops::Deref;
use std::path::PathBuf;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use hiroz::Builder;
use hiroz::context::{ZContext, ZContextBuilder};
use sm2_bridge_core::ReadAccount;
use sm2_bridge_zenoh::{Account, Bridge, Config, Counts};
use sm2_manager::Background;
use sm2_node::{Node, Publisher, Shutdown, Subscriber};
use sm2_test_support::SOON;
use zenoh::{Session, Wait};

/// When a message is sent once more: Zenoh drops a long one if its queue is full for 50 ms, as on a busy machine.
pub(crate) const RETRY: Duration = Duration::from_secs(2);

/// A rule that lets all pass.
pub(crate) const ALL: &str = "[[rule]]\naction = \"allow\"\nnames = \"**\"\n";
/// The start of the configuration of a bridge to nodes of ROS 2.
pub(crate) const SEVEN: &str = "name = \"seven\"\nmode = \"ros2\"";

/// A domain.
pub(crate) struct Domain {
    _manager: Background,
    folder: tempfile::TempDir,
}

impl Domain {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let options = sm2_manager::Options::default();
        let manager = Background::start(&folder.path().join("sock"), options).unwrap();
        Self {
            _manager: manager,
            folder,
        }
    }

    /// The path of a file of this domain.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        let socket = self.folder.path().join("sock");
        Node::builder(name).socket(socket).connect().unwrap()
    }

    /// A configuration in a file, for the program.
    pub(crate) fn write_config(&self, head: &str, endpoint: &str, rules: &str) -> PathBuf {
        let file = self.path("bridge.toml");
        fs::write(&file, text_of("client", head, endpoint, rules)).unwrap();
        file
    }
}

/// A domain, and a process of the network that bridges connect to.
pub(crate) struct World {
    domain: Domain,
    pub(crate) endpoint: String,
    pub(crate) network: Session,
}

impl Deref for World {
    type Target = Domain;

    fn deref(&self) -> &Domain {
        &self.domain
    }
}

impl World {
    pub(crate) fn new() -> Self {
        let endpoint = free_endpoint();
        Self {
            domain: Domain::new(),
            network: router(&endpoint, None),
            endpoint,
        }
    }

    /// Starts the process of the network again, after it was closed.
    pub(crate) fn open_network(&mut self) {
        self.network = router(&self.endpoint, None);
    }

    /// A configuration with these lines at its start, for a bridge that connects to `endpoint`.
    pub(crate) fn config(&self, head: &str, endpoint: &str, rules: &str) -> Config {
        self.config_of("client", head, endpoint, rules)
    }

    /// A configuration whose session is a client or a peer.
    pub(crate) fn config_of(&self, mode: &str, head: &str, endpoint: &str, rules: &str) -> Config {
        let text = text_of(mode, head, endpoint, rules);
        Config::parse(&self.path("bridge.toml"), &text).unwrap()
    }

    pub(crate) fn bridge(&self, head: &str, rules: &str) -> Running {
        self.bridge_to(&self.endpoint, head, rules)
    }

    pub(crate) fn bridge_to(&self, endpoint: &str, head: &str, rules: &str) -> Running {
        Running::start(&self.config(head, endpoint, rules))
    }
}

fn text_of(mode: &str, head: &str, endpoint: &str, rules: &str) -> String {
    format!(
        "{head}\nsocket = \"sock\"\n[zenoh]\nmode = \"{mode}\"\nconnect = [\"{endpoint}\"]\n{rules}"
    )
}

/// An endpoint where nothing listens.
pub(crate) fn free_endpoint() -> String {
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", free.local_addr().unwrap())
}

/// A router of Zenoh, which connects to another one.
pub(crate) fn router(endpoint: &str, other: Option<&str>) -> Session {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"router\"").unwrap();
    config
        .insert_json5("listen/endpoints", &format!("[\"{endpoint}\"]"))
        .unwrap();
    if let Some(other) = other {
        config
            .insert_json5("connect/endpoints", &format!("[\"{other}\"]"))
            .unwrap();
    }
    config
        .insert_json5("scouting/multicast/enabled", "false")
        .unwrap();
    zenoh::open(config).wait().unwrap()
}

/// A bridge in a thread.
pub(crate) struct Running {
    shutdown: Shutdown,
    account: ReadAccount,
    thread: JoinHandle<Account>,
}

impl Running {
    pub(crate) fn start(config: &Config) -> Self {
        let mut bridge = Bridge::start(config).unwrap();
        let shutdown = Shutdown::new().unwrap();
        let requested = shutdown.clone();
        let account = bridge.account();
        let its = account.clone();
        let thread = thread::spawn(move || {
            bridge.run(&requested).unwrap();
            // Its end sends what waits.
            drop(bridge);
            its()
        });
        Self {
            shutdown,
            account,
            thread,
        }
    }

    /// The account of the running bridge.
    pub(crate) fn account(&self) -> Account {
        (self.account)()
    }

    pub(crate) fn end(self) -> Counts {
        self.end_with_spool().counts
    }

    /// Ends the bridge. Returns its whole account.
    pub(crate) fn end_with_spool(self) -> Account {
        self.shutdown.request();
        self.thread.join().unwrap()
    }
}

#[track_caller]
pub(crate) fn wait_until(mut is_done: impl FnMut() -> bool) {
    let until = Instant::now() + SOON;
    while !is_done() {
        assert!(Instant::now() < until, "not in time");
        thread::sleep(Duration::from_millis(5));
    }
}

pub(crate) fn is_linked(publisher: &Publisher<[u8]>) -> bool {
    publisher.links().iter().any(|it| it.open)
}

pub(crate) fn receive(subscriber: &Subscriber<[u8]>) -> Vec<u8> {
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
    sample.to_vec()
}

/// Nodes of ROS 2 in the network of a bridge.
pub(crate) fn ros(world: &World) -> ZContext {
    let builder = ZContextBuilder::default().with_mode("client");
    let builder = builder.disable_multicast_scouting();
    let builder = builder.with_connect_endpoints([world.endpoint.clone()]);
    builder.build().unwrap()
}
