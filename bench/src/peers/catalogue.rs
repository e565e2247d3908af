//! The names and properties of all peers.

use super::{dds, python};

/// The implementation behind a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// SM2 itself.
    Sm2,
    /// Mechanisms of the kernel, without any middleware.
    Raw,
    /// Eclipse iceoryx2.
    Iceoryx2,
    /// Aeron, over shared memory.
    Aeron,
    /// Eclipse Zenoh.
    Zenoh,
    /// Cyclone DDS and Fast DDS.
    Dds,
    /// QUIC without any middleware.
    Quinn,
    /// SM2, iceoryx2, Zenoh and Cyclone DDS in Python.
    Python,
}

/// The hosts that the processes of a peer can be spread over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// One host.
    Host,
    /// One host, or two hosts with a link between them.
    Link,
    /// Two hosts with a link between them.
    LinkAlone,
}

/// The workloads that a peer takes part in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All that it has the means for.
    Any,
    /// Those with many messages per call: it differs from another peer in that alone.
    Batches,
    /// `pingpong` and `throughput`.
    OneToOne,
    /// `record`.
    Record,
    /// `fig4-max`, `pingpong` and `throughput`.
    OtherLanguage,
}

/// The means of a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Means {
    /// True if the peer has services.
    pub services: bool,
    /// True if the peer has nodes that discover each other and sleep when idle.
    pub nodes: bool,
}

/// A middleware in one of its configurations.
#[derive(Debug)]
pub struct PeerInfo {
    /// The name on the command line.
    pub name: &'static str,
    /// The implementation.
    pub family: Family,
    /// True if the peer needs a daemon process.
    pub daemon: bool,
    /// True if the peer may drop messages even on a lossless channel.
    pub lossy: bool,
    /// Its means.
    pub has: Means,
    /// The workloads that it takes part in.
    pub part: Part,
    /// The hosts that the processes can be spread over.
    pub reach: Reach,
    /// A description in one line.
    pub about: &'static str,
}

/// A peer with the properties that most have: nodes, services, lossless channels.
const fn peer(name: &'static str, family: Family, about: &'static str) -> PeerInfo {
    PeerInfo {
        name,
        family,
        daemon: false,
        lossy: false,
        has: Means {
            services: true,
            nodes: true,
        },
        part: Part::Any,
        reach: Reach::Host,
        about,
    }
}

/// Sends many messages per call.
const fn batching(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        part: Part::Batches,
        ..info
    }
}

/// One publisher and one subscriber, in `pingpong` and `throughput` alone.
const fn one_to_one(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        part: Part::OneToOne,
        ..bare(info)
    }
}

/// A middleware in Python or C++, in `fig4-max`, `pingpong` and `throughput` alone.
const fn other_language(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        part: Part::OtherLanguage,
        ..bare(info)
    }
}

/// A recorder, in `record` alone.
const fn recorder(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        part: Part::Record,
        ..bare(info)
    }
}

/// Without services.
const fn topics_only(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        has: Means {
            services: false,
            ..info.has
        },
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

/// Without nodes and services.
const fn bare(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        has: Means {
            services: false,
            nodes: false,
        },
        ..info
    }
}

/// Without nodes that sleep when idle.
const fn without_sleep(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        has: Means {
            nodes: false,
            ..info.has
        },
        ..info
    }
}

/// May drop messages.
const fn lossy(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        lossy: true,
        ..info
    }
}

/// With processes at one host or at two.
const fn linked(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        reach: Reach::Link,
        ..info
    }
}

/// Only between two hosts: no nodes, no services, only the newest message.
const fn across(info: PeerInfo) -> PeerInfo {
    PeerInfo {
        reach: Reach::LinkAlone,
        ..lossy(bare(info))
    }
}

/// All peers. The first one is the reference that the others are compared with.
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
        "SM2, sealed, reliable: not even the publisher can change a published message",
    )),
    without_sleep(brokered(peer(
        "sm2-spin",
        Family::Sm2,
        "SM2, pooled, reliable; subscribers spin instead of sleeping",
    ))),
    batching(brokered(peer(
        "sm2-batch",
        Family::Sm2,
        "SM2, pooled, reliable; publish_all and recv_each: many messages per call",
    ))),
    bare(peer(
        "raw-memcpy",
        Family::Raw,
        "memory alone: one process writes each message once and reads it once per subscriber",
    )),
    bare(peer(
        "raw-futex",
        Family::Raw,
        "shared memory, two slots, futex: nothing is dropped",
    )),
    bare(peer(
        "raw-seqpacket",
        Family::Raw,
        "seqpacket sockets; for messages above 4 KiB they carry the numbers of slots in shared memory",
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
    without_sleep(peer(
        "iceoryx2-poll",
        Family::Iceoryx2,
        "iceoryx2, the subscriber polls; safe overflow (its default: may drop)",
    )),
    one_to_one(brokered(peer(
        "aeron",
        Family::Aeron,
        "Aeron IPC, exclusive publication; both sides spin, the publisher retries; a media driver of its own",
    ))),
    peer(
        "zenoh-tcp",
        Family::Zenoh,
        "Zenoh, peer to peer over TCP, its default",
    ),
    linked(brokered(peer(
        "zenoh-router",
        Family::Zenoh,
        "Zenoh, clients of a router that forwards everything; over a link a router at each host, its defaults",
    ))),
    brokered(peer(
        "zenoh-rmw",
        Family::Zenoh,
        "Zenoh as rmw_zenoh sets it up: peers discover each other through a router, then connect directly",
    )),
    peer(
        "zenoh-shm",
        Family::Zenoh,
        "Zenoh, peer to peer, its shared memory provider used explicitly",
    ),
    topics_only(peer(
        "cyclone",
        Family::Dds,
        "Cyclone DDS of Debian, reliable",
    )),
    topics_only(peer(
        "cyclone-tuned",
        Family::Dds,
        "Cyclone DDS, larger datagrams and socket buffers",
    )),
    topics_only(peer(
        "fastdds",
        Family::Dds,
        "Fast DDS of Debian, reliable, sequence of bytes",
    )),
    topics_only(peer(
        "fastdds-plain",
        Family::Dds,
        "Fast DDS, plain fixed-size type with loans (data sharing)",
    )),
    other_language(brokered(peer(
        "sm2-cpp",
        Family::Dds,
        "SM2 in C++ (sm2-cpp), pooled, reliable",
    ))),
    other_language(brokered(peer(
        "sm2-python",
        Family::Python,
        "SM2 in Python, pooled, reliable; numpy arrays in shared memory",
    ))),
    other_language(peer(
        "iceoryx2-python",
        Family::Python,
        "iceoryx2 in Python (PyPI), an event wakes the subscriber; no overflow, the publisher retries",
    )),
    other_language(peer(
        "zenoh-python",
        Family::Python,
        "Zenoh in Python (PyPI), peer to peer over TCP, its default",
    )),
    other_language(peer(
        "cyclone-python",
        Family::Python,
        "Cyclone DDS in Python (PyPI), reliable",
    )),
    across(peer(
        "raw-quinn",
        Family::Quinn,
        "QUIC by quinn, its defaults (cubic): one stream per message, one at a time, the newest message",
    )),
    across(peer(
        "raw-quinn-bbr",
        Family::Quinn,
        "QUIC by quinn with the congestion controller BBR, otherwise as raw-quinn",
    )),
    recorder(brokered(peer(
        "sm2-idle",
        Family::Sm2,
        "SM2, pooled, reliable; the recorder runs while no other program wants the processor (SCHED_IDLE)",
    ))),
    recorder(brokered(peer(
        "mcap-writer",
        Family::Sm2,
        "SM2's topics, recorded by the writer of the crate mcap: BufWriter<File>, its chunks, no compression",
    ))),
    recorder(peer(
        "zenoh-shm-mcap",
        Family::Zenoh,
        "Zenoh's topics over its shared memory, recorded as by mcap-writer",
    )),
    recorder(brokered(peer(
        "raw-disk",
        Family::Sm2,
        "no recorder: one process writes as many bytes with O_DIRECT; all other topics are SM2's",
    ))),
];

/// The peer of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static PeerInfo> {
    PEERS.iter().find(|peer| peer.name == name)
}

/// The implementation behind the peer of this name.
#[must_use]
pub fn family(name: &str) -> Option<Family> {
    find(name).map(|peer| peer.family)
}

impl PeerInfo {
    /// Checks that the peer can run on this machine.
    ///
    /// # Errors
    ///
    /// The missing requirement, and how to install it.
    pub fn available(&self) -> Result<(), String> {
        let left_out =
            |feature| format!("left out of this build: build with `--features {feature}`");
        match self.family {
            Family::Sm2 | Family::Raw | Family::Quinn => Ok(()),
            Family::Iceoryx2 if cfg!(feature = "iceoryx2") => Ok(()),
            Family::Iceoryx2 => Err(left_out("iceoryx2")),
            Family::Aeron if cfg!(feature = "aeron") => Ok(()),
            Family::Aeron => Err(left_out("aeron")),
            Family::Zenoh if cfg!(feature = "zenoh") => Ok(()),
            Family::Zenoh => Err(left_out("zenoh")),
            Family::Dds => dds::available(self.name),
            Family::Python => python::available(self.name),
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
