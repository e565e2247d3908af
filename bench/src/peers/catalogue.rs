//! All peers by name, and what can be asked of them.

use super::dds;

/// Which code speaks for a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// SM2 itself.
    Sm2,
    /// What the kernel and the memory allow, without any middleware.
    Raw,
    /// Eclipse iceoryx2.
    Iceoryx2,
    /// Eclipse Zenoh.
    Zenoh,
    /// Cyclone DDS and Fast DDS.
    Dds,
    /// QUIC without any middleware.
    Quinn,
}

/// Where the processes of a peer can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// All at one host.
    Host,
    /// At one host, or at two with a link between them.
    Link,
    /// Only at two hosts.
    LinkAlone,
}

/// A peer in one way of using it.
#[derive(Debug)]
pub struct PeerInfo {
    /// Its name on the command line.
    pub name: &'static str,
    /// Which code speaks for it.
    pub family: Family,
    /// It has a process of its own, which others need.
    pub daemon: bool,
    /// It has services.
    pub services: bool,
    /// It cannot be told to drop nothing.
    pub lossy: bool,
    /// It has nodes that find each other, and sleep when they have nothing to do.
    pub nodes: bool,
    /// It differs from another one only where many messages are sent at a time.
    pub batches: bool,
    /// Where its processes can be.
    pub reach: Reach,
    /// What it is, in a line.
    pub about: &'static str,
}

/// Nodes and services, and nothing has to be dropped: what most have.
const fn peer(name: &'static str, family: Family, about: &'static str) -> PeerInfo {
    PeerInfo {
        name,
        family,
        daemon: false,
        services: true,
        lossy: false,
        nodes: true,
        batches: false,
        reach: Reach::Host,
        about,
    }
}

/// Many messages at a time.
const fn batching(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        batches: true,
        ..info
    }
}

/// Without services.
const fn topics_only(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        services: false,
        ..info
    }
}

/// With a daemon.
const fn brokered(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        daemon: true,
        ..info
    }
}

/// Bare mechanisms, which know no nodes.
const fn bare(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        services: false,
        nodes: false,
        ..info
    }
}

/// Without nodes that sleep when they have nothing to do.
const fn restless(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        nodes: false,
        ..info
    }
}

const fn lossy(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        lossy: true,
        ..info
    }
}

/// With processes at one host or two.
const fn linked(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        reach: Reach::Link,
        ..info
    }
}

/// From one host to another, and nothing else: no nodes, no services, the freshest message alone.
const fn across(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        reach: Reach::LinkAlone,
        ..lossy(bare(info))
    }
}

/// All of them. The first one is what others are compared with.
pub const PEERS: &[PeerInfo] = &[
    linked(brokered(peer(
        "sm2",
        Family::Sm2,
        "SM2, pooled, reliable: nothing is dropped; over a link keep-last, with gateways",
    ))),
    lossy(brokered(peer(
        "sm2-drop",
        Family::Sm2,
        "SM2, pooled, keep-last: a slow subscriber misses messages",
    ))),
    brokered(peer(
        "sm2-sealed",
        Family::Sm2,
        "SM2, sealed, reliable: nobody can change a message, its author included",
    )),
    restless(brokered(peer(
        "sm2-spin",
        Family::Sm2,
        "SM2, pooled, reliable; whoever waits for a message spins",
    ))),
    batching(brokered(peer(
        "sm2-batch",
        Family::Sm2,
        "SM2, pooled, reliable; publish_all and recv_each: many messages at a time",
    ))),
    bare(peer(
        "raw-memcpy",
        Family::Raw,
        "memory alone: written once and read as often, without any process in between",
    )),
    bare(peer(
        "raw-futex",
        Family::Raw,
        "shared memory, two slots, futex: nothing is dropped",
    )),
    bare(peer(
        "raw-seqpacket",
        Family::Raw,
        "seqpacket sockets; above 4 KiB they carry numbers of slots in shared memory",
    )),
    bare(peer(
        "raw-sealed",
        Family::Raw,
        "a new memfd for each message: pwrite, seal, send, map",
    )),
    bare(peer(
        "raw-spin",
        Family::Raw,
        "shared memory, spinning on both sides",
    )),
    peer(
        "iceoryx2-event",
        Family::Iceoryx2,
        "iceoryx2, an event wakes the subscriber; safe overflow (its default: may drop)",
    ),
    peer(
        "iceoryx2-event-reliable",
        Family::Iceoryx2,
        "iceoryx2, an event wakes the subscriber; no overflow, the publisher retries",
    ),
    restless(peer(
        "iceoryx2-poll",
        Family::Iceoryx2,
        "iceoryx2, the subscriber polls; safe overflow (its default: may drop)",
    )),
    peer(
        "zenoh-tcp",
        Family::Zenoh,
        "Zenoh, peer to peer over TCP, its default",
    ),
    linked(brokered(peer(
        "zenoh-router",
        Family::Zenoh,
        "Zenoh, clients of a router that carries everything; over a link one at each host, its defaults",
    ))),
    brokered(peer(
        "zenoh-rmw",
        Family::Zenoh,
        "Zenoh as rmw_zenoh sets it up: peers find each other through a router, then speak directly",
    )),
    peer(
        "zenoh-shm",
        Family::Zenoh,
        "Zenoh, peer to peer, its shared memory provider used explicitly",
    ),
    topics_only(peer(
        "cyclone",
        Family::Dds,
        "Cyclone DDS as Debian has it, reliable",
    )),
    topics_only(peer(
        "cyclone-tuned",
        Family::Dds,
        "Cyclone DDS, larger datagrams and socket buffers",
    )),
    topics_only(peer(
        "fastdds",
        Family::Dds,
        "Fast DDS as Debian has it, reliable, sequence of bytes",
    )),
    topics_only(peer(
        "fastdds-plain",
        Family::Dds,
        "Fast DDS, plain fixed-size type with loans (data sharing)",
    )),
    across(peer(
        "raw-quinn",
        Family::Quinn,
        "QUIC by quinn, its defaults (cubic): a stream for each message, one at a time, the freshest",
    )),
    across(peer(
        "raw-quinn-bbr",
        Family::Quinn,
        "the same with the congestion controller BBR",
    )),
];

/// The peer of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static PeerInfo> {
    PEERS.iter().find(|peer| peer.name == name)
}

/// Which code speaks for the peer of this name.
#[must_use]
pub fn family(name: &str) -> Option<Family> {
    find(name).map(|peer| peer.family)
}

impl PeerInfo {
    /// Whether it can run here.
    ///
    /// # Errors
    ///
    /// Why not, and what would help.
    pub fn available(&self) -> Result<(), String> {
        let left_out =
            |feature| format!("left out of this build: build with `--features {feature}`");
        match self.family {
            Family::Sm2 | Family::Raw | Family::Quinn => Ok(()),
            Family::Iceoryx2 if cfg!(feature = "iceoryx2") => Ok(()),
            Family::Iceoryx2 => Err(left_out("iceoryx2")),
            Family::Zenoh if cfg!(feature = "zenoh") => Ok(()),
            Family::Zenoh => Err(left_out("zenoh")),
            Family::Dds => dds::available(self.name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{PEERS, family, find};

    #[test]
    fn names_are_unique_and_found() {
        for (at, peer) in PEERS.iter().enumerate() {
            assert!(PEERS[..at].iter().all(|other| other.name != peer.name));
            assert_eq!(find(peer.name).unwrap().about, peer.about);
        }
        assert_eq!(family("zenoh"), None);
    }

    #[test]
    fn the_reference_comes_first_and_runs_everywhere() {
        assert_eq!(PEERS[0].name, "sm2");
        assert!(PEERS[0].available().is_ok());
    }
}
