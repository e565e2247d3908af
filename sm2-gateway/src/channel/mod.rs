//! The queues between the tasks of a gateway: what each task receives, and the sending halves.
//!
//! | receiving task | sending half | received values |
//! | --- | --- | --- |
//! | hub | [`HubHandle`](hub::HubHandle) | [`HubEvent`](hub::HubEvent) |
//! | network | [`NetworkHandle`](network::NetworkHandle) | [`NetworkEvent`](network::NetworkEvent) |
//! | one connection | [`PeerHandle`](connection::PeerHandle) | QUIC events, hub commands, queries |
//! | local | [`LocalHandle`](local::LocalHandle) | [`LocalCommand`](crate::hub::LocalCommand) |
//!
//! These modules hold types and queues only. The tasks in `run` and the nodes in `local` depend on
//! them, never the other way round.

pub(crate) mod connection;
pub(crate) mod hub;
pub(crate) mod local;
pub(crate) mod network;
