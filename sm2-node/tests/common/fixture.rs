use sm2_node::{Client, Node, NodeBuilder, Publisher, Server, Shutdown, Subscriber};

use super::{Domain, SOON};

/// With a background thread of each node, and without it; each with and without the ring lane.
const DRIVEN: [(bool, bool); 4] = [(true, true), (true, false), (false, true), (false, false)];

/// A domain whose nodes have a background thread or not, and the ring lane or not.
pub(crate) struct Fixture {
    pub(crate) domain: Domain,
    pub(crate) shutdown: Shutdown,
    background: bool,
    ring: bool,
}

impl Fixture {
    /// Runs a test for each combination.
    pub(crate) fn each(test: impl Fn(&Self)) {
        for (background, ring) in DRIVEN {
            test(&Self {
                domain: Domain::new(),
                shutdown: Shutdown::new().unwrap(),
                background,
                ring,
            });
        }
    }

    /// The same in a new domain.
    pub(crate) fn again(&self) -> Self {
        Self {
            domain: Domain::new(),
            shutdown: Shutdown::new().unwrap(),
            ..*self
        }
    }

    pub(crate) fn builder(&self, name: &str) -> NodeBuilder {
        let builder = self.domain.builder(name);
        builder.background(self.background).ring_lane(self.ring)
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        self.builder(name).connect().unwrap()
    }

    /// A node whose waits the shutdown ends.
    pub(crate) fn ending_node(&self, name: &str) -> Node {
        let builder = self.builder(name).shutdown(&self.shutdown);
        builder.connect().unwrap()
    }

    /// A node that lives without calls of the test.
    pub(crate) fn peer(&self, name: &str) -> Node {
        self.builder(name).background(true).connect().unwrap()
    }
}

/// The other side of each interface of a robot: the topics `topic` and `other`, the services `double` and `triple`.
pub(crate) struct Peer {
    pub(crate) triple: Server<u64, u64>,
    pub(crate) topic: Publisher<u64>,
    pub(crate) double: Client<u64, u64>,
    _other: Subscriber<u64>,
}

impl Peer {
    /// Connects it, and waits until the robot's subscriber and its server are linked.
    pub(crate) fn new(fixture: &Fixture) -> Self {
        let node = fixture.peer("peer");
        let peer = Self {
            triple: node.server("triple").unwrap(),
            _other: node.subscriber("other").unwrap(),
            topic: node.publisher("topic").unwrap(),
            double: node.client("double").unwrap(),
        };
        peer.topic.wait_for_subscribers_timeout(1, SOON).unwrap();
        peer.double.wait_for_servers_timeout(1, SOON).unwrap();
        peer
    }

    /// Serves one call of `triple`.
    pub(crate) fn triple_once(&self) {
        let request = self.triple.recv_timeout(SOON).unwrap().expect("a request");
        let tripled = *request * 3;
        request.reply(&tripled).unwrap();
    }
}
