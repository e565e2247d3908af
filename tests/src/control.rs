//! Control frames written by hand, from SPEC section 3 alone. Nothing here calls the encoder of
//! `sm2-proto`, so the two check each other.

use sm2_proto::{EntityId, LinkId, control::Key};

/// Bytes of a control frame, field by field.
#[derive(Clone, Debug, Default)]
pub struct Fields(Vec<u8>);

impl Fields {
    /// A frame without fields.
    #[must_use]
    pub const fn new() -> Self {
        Self(Vec::new())
    }

    /// An integer wider than 8 bits: a varint.
    #[must_use]
    pub fn int(mut self, value: u64) -> Self {
        let mut rest = value;
        while rest >= 0x80 {
            self.0.push((rest & 0x7f) as u8 | 0x80);
            rest >>= 7;
        }
        self.0.push(rest as u8);
        self
    }

    /// A `bool`.
    #[must_use]
    pub fn flag(self, value: bool) -> Self {
        self.raw([u8::from(value)])
    }

    /// A string.
    #[must_use]
    pub fn text(self, text: impl AsRef<[u8]>) -> Self {
        let text = text.as_ref();
        self.int(text.len() as u64).raw(text)
    }

    /// A link's id.
    #[must_use]
    pub fn link(self, link: LinkId) -> Self {
        self.int(link.epoch).int(link.serial)
    }

    /// Appends these bytes.
    #[must_use]
    pub fn raw(mut self, bytes: impl AsRef<[u8]>) -> Self {
        self.0.extend_from_slice(bytes.as_ref());
        self
    }

    /// Returns all bytes.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        self.0
    }
}

fn frame(number: u64) -> Fields {
    Fields::new().int(number)
}

/// HELLO for version 1.
#[must_use]
pub fn hello(name: impl AsRef<[u8]>) -> Vec<u8> {
    hello_versions(1, 1, name)
}

/// HELLO for a range of versions.
#[must_use]
pub fn hello_versions(min: u16, max: u16, name: impl AsRef<[u8]>) -> Vec<u8> {
    let versions = frame(0).int(min.into()).int(max.into());
    versions.text(name).flag(false).bytes()
}

/// HELLO of a node that reconnects.
#[must_use]
pub fn hello_again(name: impl AsRef<[u8]>) -> Vec<u8> {
    frame(0).int(1).int(1).text(name).flag(true).bytes()
}

/// DECLARE.
#[must_use]
pub fn declare(interface: u64, contract: &[u8]) -> Vec<u8> {
    frame(1).int(interface).raw(contract).bytes()
}

/// WITHDRAW.
#[must_use]
pub fn withdraw(interface: u64) -> Vec<u8> {
    frame(2).int(interface).bytes()
}

/// UNLINKED.
#[must_use]
pub fn unlinked(interface: u64, link: LinkId, code: u16) -> Vec<u8> {
    frame(3).int(interface).link(link).int(code.into()).bytes()
}

/// QUERY from the start.
#[must_use]
pub fn query() -> Vec<u8> {
    frame(4).flag(false).bytes()
}

/// QUERY for the items after this one.
#[must_use]
pub fn query_after(key: Key) -> Vec<u8> {
    let entity = |fields: Fields, it: EntityId| fields.int(it.node.0).int(it.interface.0);
    let after = frame(4).flag(true);
    let after = match key {
        Key::Domain => after.int(0),
        Key::Member { entity: it } => entity(after.int(1), it),
        Key::Link { link, offering } => entity(after.int(2).link(link), offering),
        Key::Claim { link, entity: it } => entity(after.int(3).link(link), it),
        Key::Unlinked {
            offering,
            demanding,
        } => entity(entity(after.int(4), offering), demanding),
    };
    after.bytes()
}

/// GOODBYE of a node.
#[must_use]
pub fn goodbye(code: u16) -> Vec<u8> {
    frame(5).int(code.into()).bytes()
}

/// CLAIM, whose fields a test may change.
#[derive(Clone, Copy, Debug)]
pub struct Claim {
    /// The node's interface.
    pub interface: u64,
    /// The link.
    pub link: LinkId,
    /// The secret of its two ends.
    pub key: u64,
    /// Its version.
    pub version: u16,
    /// True if no message on the link may be displaced.
    pub reliable: bool,
    /// True if pooled payloads are forbidden.
    pub sealed: bool,
}

impl Claim {
    /// Returns the bytes of the frame.
    #[must_use]
    pub fn bytes(self) -> Vec<u8> {
        let head = frame(6).int(self.interface).link(self.link).int(self.key);
        let terms = head.int(self.version.into());
        terms.flag(self.reliable).flag(self.sealed).bytes()
    }
}

/// CLAIMED.
#[must_use]
pub fn claimed() -> Vec<u8> {
    frame(7).bytes()
}

/// WATCH.
#[must_use]
pub fn watch(after: u64) -> Vec<u8> {
    frame(8).int(after).bytes()
}

/// COUNTERS.
#[must_use]
pub fn counters() -> Vec<u8> {
    frame(9).bytes()
}

/// The number of MAX_LINKS, which nodes send at any time.
pub const MAX_LINKS: u8 = 13;

/// INSPECT.
#[must_use]
pub fn inspect(node: u64) -> Vec<u8> {
    frame(10).int(node).bytes()
}

/// SCHEMA.
#[must_use]
pub fn schema(data: &[u8], text: impl AsRef<[u8]>) -> Vec<u8> {
    frame(11).raw(data).text(text).bytes()
}

/// DESCRIBE.
#[must_use]
pub fn describe(data: &[u8]) -> Vec<u8> {
    frame(12).raw(data).bytes()
}

/// RELOAD.
#[must_use]
pub fn reload() -> Vec<u8> {
    frame(14).bytes()
}

/// SUSPENDED.
#[must_use]
pub fn suspended(interface: u64) -> Vec<u8> {
    frame(15).int(interface).bytes()
}

/// The quality of service of a contract, whatever its kind.
#[derive(Clone, Copy, Debug)]
pub struct Qos {
    /// `depth`
    pub depth: u16,
    /// `reliable`
    pub reliable: bool,
    /// `latched`
    pub latched: u16,
    /// `max_borrowed`
    pub max_borrowed: u16,
    /// `sealed`
    pub sealed: bool,
    /// `deadline`
    pub deadline: u64,
    /// `lifespan`
    pub lifespan: u64,
    /// `lease`
    pub lease: u64,
}

impl Qos {
    /// The quality of service of a plain interface.
    pub const PLAIN: Self = Self {
        depth: 4,
        reliable: false,
        latched: 0,
        max_borrowed: 2,
        sealed: false,
        deadline: 0,
        lifespan: 0,
        lease: 0,
    };
    /// Plain and reliable.
    pub const RELIABLE: Self = Self {
        reliable: true,
        ..Self::PLAIN
    };
    /// Plain and sealed.
    pub const SEALED: Self = Self {
        sealed: true,
        ..Self::PLAIN
    };

    /// As the field `qos` of a server or client.
    fn of_service(self) -> Vec<u8> {
        let fields = Fields::new().int(self.depth.into());
        fields
            .int(self.max_borrowed.into())
            .flag(self.sealed)
            .bytes()
    }
}

/// The type of raw bytes.
#[must_use]
pub fn bytes_type() -> Vec<u8> {
    type_id("bytes", 0)
}

/// A type.
#[must_use]
pub fn type_id(name: &str, hash: u64) -> Vec<u8> {
    Fields::new().text(name).int(hash).bytes()
}

/// A publisher of raw bytes.
#[must_use]
pub fn publisher(topic: impl AsRef<[u8]>, qos: Qos) -> Vec<u8> {
    typed_publisher(topic, &bytes_type(), qos)
}

/// A publisher of this type.
#[must_use]
pub fn typed_publisher(topic: impl AsRef<[u8]>, data: &[u8], qos: Qos) -> Vec<u8> {
    let head = Fields::new().int(0).text(topic).raw(data);
    let offer = head.int(qos.depth.into()).flag(qos.reliable);
    let offer = offer.int(qos.latched.into()).flag(qos.sealed);
    let offer = offer.int(qos.deadline).int(qos.lifespan);
    offer.int(qos.lease).bytes()
}

/// A subscriber of raw bytes.
#[must_use]
pub fn subscriber(topic: impl AsRef<[u8]>, qos: Qos) -> Vec<u8> {
    let head = Fields::new().int(1).text(topic);
    let demand = head.flag(true).raw(bytes_type()).int(qos.depth.into());
    let demand = demand.flag(qos.reliable).int(qos.max_borrowed.into());
    let demand = demand.flag(qos.sealed);
    demand.int(qos.deadline).int(qos.lease).bytes()
}

/// A server of raw bytes.
#[must_use]
pub fn server(service: impl AsRef<[u8]>, qos: Qos) -> Vec<u8> {
    let head = Fields::new().int(2).text(service);
    let types = head.raw(bytes_type()).raw(bytes_type());
    types.raw(qos.of_service()).bytes()
}

/// A client of raw bytes.
#[must_use]
pub fn client(service: impl AsRef<[u8]>, qos: Qos) -> Vec<u8> {
    let head = Fields::new().int(3).text(service).flag(true);
    let types = head.raw(bytes_type()).raw(bytes_type());
    types.raw(qos.of_service()).bytes()
}

/// Frames from the Manager to a node.
pub mod to_node {
    use super::{Fields, LinkId, frame};

    /// WELCOME.
    #[must_use]
    pub fn welcome(version: u16, epoch: u64, node: u64) -> Vec<u8> {
        frame(0).int(version.into()).int(epoch).int(node).bytes()
    }

    /// HELLO_REFUSED because the name is taken.
    #[must_use]
    pub fn hello_refused() -> Vec<u8> {
        frame(1).int(0).bytes()
    }

    /// DECLARED.
    #[must_use]
    pub fn declared(interface: u64, matches: u32) -> Vec<u8> {
        frame(2).int(interface).int(matches.into()).bytes()
    }

    /// DECLARE_REFUSED: a topic of another type.
    #[must_use]
    pub fn declare_refused(interface: u64, theirs: &[u8]) -> Vec<u8> {
        frame(3).int(interface).int(2).raw(theirs).bytes()
    }

    /// LINK, whose fields a test may change.
    #[derive(Clone, Debug)]
    pub struct Link {
        /// The node's interface.
        pub interface: u64,
        /// The link.
        pub link: LinkId,
        /// The secret of its two ends.
        pub key: u64,
        /// Its version.
        pub version: u16,
        /// True if no message on the link may be displaced.
        pub reliable: bool,
        /// True if pooled payloads are forbidden.
        pub sealed: bool,
        /// The peer's contract.
        pub contract: Vec<u8>,
    }

    impl Link {
        /// Returns the bytes of the frame; the peer is interface 1 of node 77, `peer`.
        #[must_use]
        pub fn bytes(&self) -> Vec<u8> {
            let head = frame(4).int(self.interface).link(self.link);
            let terms = head.int(self.key).int(self.version.into());
            let peer = terms.flag(self.reliable).flag(self.sealed).int(77);
            peer.text("peer").int(1).raw(&self.contract).bytes()
        }
    }

    /// UNLINK.
    #[must_use]
    pub fn unlink(interface: u64, link: LinkId, code: u16) -> Vec<u8> {
        frame(5).int(interface).link(link).int(code.into()).bytes()
    }

    /// WITHDRAWN.
    #[must_use]
    pub fn withdrawn(interface: u64) -> Vec<u8> {
        frame(6).int(interface).bytes()
    }

    /// PAGE with these items, and nothing after them.
    #[must_use]
    pub fn page(items: &[Vec<u8>]) -> Vec<u8> {
        let head = frame(7).int(1).int(items.len() as u64);
        let all = items.iter().fold(head, Fields::raw);
        all.flag(false).bytes()
    }

    /// A node on a page.
    #[must_use]
    pub fn node_item(name: impl AsRef<[u8]>) -> Vec<u8> {
        let node = Fields::new().int(1).int(1).text(name);
        node.int(0).int(2).flag(false).flag(false).bytes()
    }

    /// GOODBYE of a Manager.
    #[must_use]
    pub fn goodbye(code: u16) -> Vec<u8> {
        frame(8).int(code.into()).bytes()
    }

    /// CHANGES without changes: the Manager has forgotten them.
    #[must_use]
    pub fn changes(revision: u64) -> Vec<u8> {
        frame(9).int(revision).flag(false).flag(false).bytes()
    }

    /// INSPECTED.
    #[must_use]
    pub fn inspected(node: u64) -> Vec<u8> {
        frame(10).int(node).bytes()
    }

    /// NOT_INSPECTED.
    #[must_use]
    pub fn not_inspected(node: u64) -> Vec<u8> {
        frame(11).int(node).bytes()
    }

    /// RELOADED: the policy is applied.
    #[must_use]
    pub fn reloaded() -> Vec<u8> {
        frame(14).int(0).bytes()
    }

    /// DESCRIBED.
    #[must_use]
    pub fn described(data: &[u8], text: Option<&str>) -> Vec<u8> {
        let head = frame(12).raw(data);
        match text {
            Some(text) => head.flag(true).text(text).bytes(),
            None => head.flag(false).bytes(),
        }
    }
}
