use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard, PoisonError},
};

use sm2_io::quic::Socket;
use sm2_proto::gateway::GatewayId;

use crate::{
    channel::{hub::HubHandle, network::NetworkHandle},
    clock::Clock,
    peer::{Budget, Limits, Me},
    report::ShadowReport,
};

/// State that the tasks of a gateway share.
#[derive(Debug)]
pub(super) struct GatewayState {
    pub(super) clock: Clock,
    pub(super) me: Me,
    pub(super) limits: Limits,
    /// The memory of all connections.
    pub(super) budget: Budget,
    pub(super) socket: Socket,
    pub(super) hub: HubHandle,
    pub(super) network: NetworkHandle,
    /// The epoch of each peer with an open connection: a process with a smaller one is stale.
    pub(super) epochs: Mutex<BTreeMap<GatewayId, u64>>,
    /// The changes that the shadow configuration would make, if there is one.
    pub(super) shadow: Mutex<Option<Vec<ShadowReport>>>,
}

/// Locks a mutex. Its values are replaced as a whole, so a panic elsewhere leaves them valid.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
