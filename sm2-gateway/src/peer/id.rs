//! The identity of this gateway towards peers, and identifiers of connections and their calls.

use sm2_proto::{
    Name,
    gateway::{Hop, StreamToken},
};

/// The identity of this gateway, as its sessions state it.
#[derive(Clone, Debug)]
pub struct Me {
    /// The id and epoch.
    pub hop: Hop,
    /// The name.
    pub name: Name,
}

/// The number of a connection. No two connections of a process have the same one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

/// The number of a call that the hub passes on, to a peer or to a server of the domain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallId(pub u64);

/// A call of the peer, identified by the stream that carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerCall(pub StreamToken);
