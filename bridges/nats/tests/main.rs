//! Tests of the bridge with a real server of NATS (`nats-server`, a package of Debian).

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::{self, JoinHandle};

use sm2_bridge_nats::{Account, Bridge, Config};
use sm2_manager::Background;
use sm2_node::{Node, Publisher, Shutdown, Subscriber};
use sm2_test_support::{SOON, skip_without, until};
use tempfile::TempDir;

const OUT: &str = "[[rule]]\naction = \"allow\"\nnames = \"arm/*\"\ndirection = \"out\"\n";
const IN: &str = "[[rule]]\naction = \"allow\"\nnames = \"arm/pose\"\ndirection = \"in\"\n";

/// A server, which keeps its streams in a folder.
struct Server {
    folder: TempDir,
    port: u16,
    process: Child,
}

impl Server {
    /// `None` where `nats-server` is not installed: then the test has to return.
    fn start() -> Option<Self> {
        let found = Command::new("nats-server").arg("--version").output();
        if let Err(error) = found {
            skip_without("nats-server", error);
            return None;
        }
        let folder = TempDir::new().unwrap();
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = free.local_addr().unwrap().port();
        drop(free);
        let process = run(folder.path(), port);
        Some(Self {
            folder,
            port,
            process,
        })
    }

    fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    fn start_again(&mut self) {
        self.process = run(self.folder.path(), self.port);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn run(folder: &Path, port: u16) -> Child {
    let mut command = Command::new("nats-server");
    command.args([
        "--addr",
        "127.0.0.1",
        "--jetstream",
        "--port",
        &port.to_string(),
    ]);
    command.arg("--store_dir").arg(folder);
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// A domain.
struct World {
    _manager: Background,
    folder: TempDir,
}

impl World {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        let options = sm2_manager::Options::default();
        let manager = Background::start(&folder.path().join("sock"), options).unwrap();
        Self {
            _manager: manager,
            folder,
        }
    }

    fn node(&self, name: &str) -> Node {
        let socket = self.folder.path().join("sock");
        Node::builder(name).socket(socket).connect().unwrap()
    }

    fn bridge(&self, name: &str, port: u16, rules: &str) -> Running {
        let text = format!(
            "name = \"{name}\"\nsocket = \"sock\"\n[nats]\nservers = [\"nats://127.0.0.1:{port}\"]\n\
             stream = \"fleet\"\n[spool]\nfolder = \"spool\"\n{rules}"
        );
        let config = Config::parse(&self.folder.path().join("bridge.toml"), &text).unwrap();
        let mut bridge = Bridge::start(&config).unwrap();
        let shutdown = Shutdown::new().unwrap();
        let requested = shutdown.clone();
        let thread = thread::spawn(move || {
            bridge.run(&requested).unwrap();
            bridge.account()()
        });
        Running { shutdown, thread }
    }
}

/// A bridge in a thread.
struct Running {
    shutdown: Shutdown,
    thread: JoinHandle<Account>,
}

impl Running {
    fn end(self) -> Account {
        self.shutdown.request();
        self.thread.join().unwrap()
    }
}

/// Publishes messages, which the bridge has when it returns.
fn publish(publisher: &Publisher<[u8]>, numbers: impl IntoIterator<Item = u8>) {
    let open = || {
        publisher
            .links()
            .into_iter()
            .filter(|it| it.open)
            .collect::<Vec<_>>()
    };
    until("the bridge takes the topic", || !open().is_empty());
    for number in numbers {
        publisher.publish(&[number]).unwrap();
    }
    until("the bridge has the messages", || {
        open()
            .iter()
            .all(|it| it.counters.delivered == it.counters.offered)
    });
}

/// Takes these messages, each once, in order.
#[track_caller]
fn take(subscriber: &Subscriber<[u8]>, numbers: impl IntoIterator<Item = u8>) {
    for number in numbers {
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
        assert_eq!(*sample, [number]);
    }
}

#[test]
fn messages_survive_outages_of_the_server_and_come_once() {
    let Some(mut server) = Server::start() else {
        return;
    };
    let (robot, site) = (World::new(), World::new());
    let publisher = robot.node("arm").publisher::<[u8]>("arm/pose").unwrap();
    let denied = robot.node("arm2").publisher::<[u8]>("arm/secret").unwrap();
    let subscriber = site.node("map").subscriber_builder::<[u8]>("arm/pose");
    let subscriber = subscriber.depth(64).declare().unwrap();
    let secret = site.node("thief").subscriber::<[u8]>("arm/secret").unwrap();
    // The robot starts without a server.
    server.kill();
    let out = robot.bridge("robot", server.port, OUT);
    publish(&publisher, 0..5);
    publish(&denied, [0]);
    server.start_again();
    let into = site.bridge("site", server.port, IN);
    take(&subscriber, 0..5);
    server.kill();
    publish(&publisher, 5..10);
    server.start_again();
    take(&subscriber, 5..10);
    // More messages come while the site is away.
    let counts = into.end().counts;
    assert_eq!(counts.received, 10, "{counts}");
    publish(&publisher, 10..15);
    let into = site.bridge("site", server.port, IN);
    take(&subscriber, 10..15);
    assert!(secret.try_recv().unwrap().is_none());
    into.end();
    let spool = out.end().spool.unwrap();
    assert!(spool.is_balanced(), "{spool}");
    assert_eq!(
        (spool.offered, spool.expired, spool.refused),
        (16, 0, 0),
        "{spool}"
    );
}

#[test]
fn messages_of_the_next_publisher_are_no_duplicates() {
    let Some(server) = Server::start() else {
        return;
    };
    let (robot, site) = (World::new(), World::new());
    let subscriber = site.node("map").subscriber_builder::<[u8]>("arm/pose");
    let subscriber = subscriber.depth(64).declare().unwrap();
    let out = robot.bridge("robot", server.port, OUT);
    let into = site.bridge("site", server.port, IN);
    let node = robot.node("arm");
    for numbers in [0..5, 5..10] {
        let publisher = node.publisher::<[u8]>("arm/pose").unwrap();
        publish(&publisher, numbers.clone());
        take(&subscriber, numbers);
        drop(publisher);
        until("the bridge takes the topic no more", || {
            let domain = node.snapshot().unwrap();
            let bridge = domain.node_named("bridge/robot").unwrap().node;
            !domain.interfaces().any(|it| it.entity.node == bridge)
        });
    }
    out.end();
    into.end();
}

#[test]
fn messages_of_the_own_domain_do_not_come_back() {
    let Some(server) = Server::start() else {
        return;
    };
    let world = World::new();
    let node = world.node("arm");
    let publisher = node.publisher::<[u8]>("arm/pose").unwrap();
    let subscriber = node.subscriber_builder::<[u8]>("arm/pose");
    let subscriber = subscriber.depth(64).declare().unwrap();
    let both = "[[rule]]\naction = \"allow\"\nnames = \"arm/*\"\n";
    let bridge = world.bridge("robot", server.port, both);
    until("both subscribe", || {
        publisher.links().iter().filter(|it| it.open).count() == 2
    });
    for number in 0..3 {
        publisher.publish(&[number]).unwrap();
    }
    take(&subscriber, 0..3);
    // Without numbers to publish, this waits until the bridge has the messages.
    publish(&publisher, []);
    // A message of another domain is a marker. It is behind the others in the stream, because that domain has them.
    let other = World::new();
    let node = other.node("arm");
    let marker = node.publisher::<[u8]>("arm/pose").unwrap();
    let seen = other.node("map").subscriber_builder::<[u8]>("arm/pose");
    let seen = seen.depth(64).declare().unwrap();
    let out = other.bridge("other", server.port, both);
    take(&seen, 0..3);
    marker.publish(&[99]).unwrap();
    take(&subscriber, [99]);
    out.end();
    let counts = bridge.end().counts;
    assert_eq!((counts.received, counts.returned), (1, 3), "{counts}");
}

#[test]
fn wrong_configurations_are_refused_with_the_line() {
    let head =
        "name = \"a\"\n[nats]\nservers = [\"nats://h\"]\nstream = \"s\"\n[spool]\nfolder = \"f\"\n";
    for (text, expected) in [
        (
            head.replace("\"nats://h\"", ""),
            "bridge.toml:3: `servers` names no server",
        ),
        (
            format!("{head}[[rule]]\naction = \"allow\"\nnames = \"a\"\ndurable = true\n"),
            "bridge.toml:10: `durable` has no effect",
        ),
        (
            format!("{head}[[rule]]\naction = \"allow\"\nkind = \"service\"\nnames = \"a\"\n"),
            "bridge.toml:10: this bridge carries topics only",
        ),
        (
            head.replace("\"a\"", "\"a b\""),
            "bridge.toml:1: a name holds only",
        ),
    ] {
        let error = Config::parse(Path::new("bridge.toml"), &text).unwrap_err();
        assert!(error.to_string().starts_with(expected), "{error}");
    }
}
