//! Identifiers of connections and of the calls that they carry.

use sm2_proto::gateway::StreamToken;

/// The number of a connection. No two connections of a process have the same one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub u64);

/// The number of a call that the hub passes on, to a peer or to a server of the domain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallId(pub u64);

/// A call of the peer's, by the stream that carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerCall(pub StreamToken);
