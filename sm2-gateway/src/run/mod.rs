//! A running gateway: its tasks.
//!
//! | task | owns |
//! | --- | --- |
//! | `network` | the UDP socket, the QUIC endpoint, discovery and beacons |
//! | `connection`, one for each | QUIC, the session, the schedule and the memory of one peer |
//! | `hub` | routes and calls |
//! | `local`, a thread | the nodes in the domain |
//! | `shadow` | the comparison with another configuration |
//!
//! The tasks talk through the queues of `channel`. No task waits for a connection: a message or
//! datagram that finds the queue of a connection full is dropped. So a slow, stuck or hostile peer
//! affects no other peer.

mod beacons;
mod connection;
mod gateway_state;
mod hosts;
mod hub;
mod local;
mod network;
mod shadow;
mod status;
mod thread;
mod timer;

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, Mutex},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use sm2_io::quic::{Endpoint, Socket, TlsError, Trusted};
use sm2_proto::gateway::{GatewayId, Hop};
use tokio::sync::watch;

pub use self::beacons::BeaconsError;
use self::{beacons::Beacons, gateway_state::GatewayState, hosts::Hosts};
use crate::{
    channel::{
        self,
        hub::{ConfigLabels, HubEvent, HubHandle},
        network::{NetworkEvent, NetworkHandle},
    },
    clock::Clock,
    config::Config,
    hub::{Hub, Room},
    keys::{self, KeyFileError},
    local::{Local, LocalError},
    peer::{Budget, Me},
    report::Report,
};

/// Time for the connection tasks to send their close frames.
const CLOSE_DELAY: Duration = Duration::from_millis(500);

/// More descriptors than this have no use: the Manager lets a node have so many interfaces and links at most.
const DESCRIPTORS_MAX: usize = 1 << 16;

/// Why a gateway did not start or stopped by itself.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The key file cannot be read, or is not a key file.
    #[error(transparent)]
    Key(#[from] KeyFileError),
    /// The gateway cannot join its domain.
    #[error(transparent)]
    Local(#[from] LocalError),
    /// The address is in use, or does not belong to this machine.
    #[error("cannot listen at {address}: {source}; change `listen` in {config}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        r#source: io::Error,
        /// The path of the configuration.
        config: String,
    },
    /// The sockets for beacons cannot be opened.
    #[error(transparent)]
    Beacons(#[from] BeaconsError),
    /// TLS refuses the key.
    #[error("TLS refuses the key: {0}")]
    Tls(TlsError),
    /// The UDP socket failed, or a task of the gateway has ended.
    #[error("the network task of the gateway ended: {0}")]
    Network(io::Error),
}

/// A running gateway.
#[derive(Debug)]
pub struct Gateway {
    hub: HubHandle,
    network: NetworkHandle,
    trusted: Trusted,
    address: SocketAddr,
    id: GatewayId,
    ended: watch::Receiver<Option<Arc<io::Error>>>,
    shadow: watch::Sender<Option<Arc<Config>>>,
}

impl Gateway {
    /// Starts the tasks of a gateway.
    ///
    /// The gateway communicates in the network namespace of the calling thread. If the threads of the runtime are in
    /// another one, then all peers share one socket, and a peer whose link is stuck can hold up the others.
    ///
    /// # Errors
    /// See [`RunError`].
    ///
    /// # Panics
    /// Outside of a tokio runtime with I/O and time enabled.
    pub async fn start(config: &Config) -> Result<Self, RunError> {
        let room = room();
        let key = keys::load(&config.key)?;
        let id = key.id();
        let socket = Socket::bind(config.listen).map_err(|source| RunError::Listen {
            address: config.listen,
            source,
            config: config.path.display().to_string(),
        })?;
        let beacons = Beacons::open(&config.discovery)?;
        let address = socket.local_addr().map_err(RunError::Network)?;
        let trusted = Trusted::default();
        trusted.set(config.peers.iter().map(|it| it.id));
        let endpoint = Endpoint::new(key, trusted.clone(), config.congestion, None);
        let endpoint = endpoint.map_err(RunError::Tls)?;
        let hop = Hop {
            gateway: id,
            epoch: epoch(),
        };
        let (hub, hub_inbox) = channel::hub::channel();
        let (network, network_inbox) = channel::network::channel();
        let (local, local_inbox) = channel::local::channel();
        local::start(joins(config, &hub), local_inbox, hub.clone()).await?;
        let shared = Arc::new(GatewayState {
            clock: Clock::of_the_machine(),
            me: Me {
                hop,
                name: config.name.clone(),
            },
            limits: config.limits,
            budget: Budget::new(config.limits.gateway_bytes),
            socket,
            hub: hub.clone(),
            network: network.clone(),
            epochs: Mutex::default(),
            shadow: Mutex::default(),
        });
        let (ending, ended) = watch::channel(None);
        tokio::spawn(hub::run(
            Hub::new(hop, config.policy.clone()).with_room(room),
            labels(config),
            Arc::clone(&shared),
            hub_inbox,
            local,
        ));
        let (shadow, shadows) = watch::channel(None);
        tokio::spawn(shadow::run(shadows, Arc::clone(&shared)));
        let peers = config.peers.clone();
        let look_up = config.look_up;
        tokio::spawn(async move {
            let hosts = Hosts::new(look_up);
            let network = network::Network::new(endpoint, beacons, shared, address, hosts);
            let error = network.run(peers, network_inbox).await;
            let _ = ending.send(error.err().map(Arc::new));
        });
        tracing::info!(%id, %address, name = %config.name, "gateway started");
        Ok(Self {
            hub,
            network,
            trusted,
            address,
            id,
            ended,
            shadow,
        })
    }

    /// The address of the UDP socket.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// The id of the gateway: its public key.
    #[must_use]
    pub const fn id(&self) -> GatewayId {
        self.id
    }

    /// Replaces the rules, with their limits, and the peers by those of `config`. Other settings of
    /// `config` have no effect.
    //= SM2-GWR-004
    pub async fn reload(&self, config: &Config) {
        self.trusted.set(config.peers.iter().map(|it| it.id));
        // The hub needs no rules once it has ended.
        self.network.send(NetworkEvent::Peers(config.peers.clone()));
        let policy = config.policy.clone();
        let labels = labels(config);
        let _ = self.hub.send(HubEvent::Reload { policy, labels }).await;
    }

    /// Logs and reports from now on what the rules and peers of `config` would change: at once, and
    /// when a new topic or service makes a difference. Has no effect on messages.
    pub fn set_shadow(&self, config: Config) {
        self.shadow.send_replace(Some(Arc::new(config)));
    }

    /// A status report; `None` if the gateway has stopped.
    pub async fn report(&self) -> Option<Report> {
        self.hub.report().await.ok()
    }

    /// Serves `/metrics` over HTTP as long as the gateway runs: see
    /// [`metrics`](crate::metrics).
    #[cfg(feature = "metrics")]
    pub fn serve_metrics(&self, listener: tokio::net::TcpListener) {
        self.serve_metrics_within(listener, crate::metrics::Timeouts::default());
    }

    /// As [`serve_metrics`](Self::serve_metrics), with other timeouts: for tests.
    #[doc(hidden)]
    #[cfg(feature = "metrics")]
    pub fn serve_metrics_within(
        &self,
        listener: tokio::net::TcpListener,
        timeouts: crate::metrics::Timeouts,
    ) {
        let hub = self.hub.clone();
        tokio::spawn(crate::metrics::serve(listener, hub, timeouts));
    }

    /// Completes when the gateway has stopped by itself, with the reason.
    pub async fn ended(&mut self) -> RunError {
        let ended = self.ended.wait_for(Option::is_some).await;
        let error = ended.ok().and_then(|it| it.clone());
        let error = error.map_or_else(
            || io::Error::other("another task of the gateway has ended"),
            |it| io::Error::new(it.kind(), it.to_string()),
        );
        RunError::Network(error)
    }

    /// Closes all connections and leaves the domain.
    pub async fn stop(self) {
        self.network.send(NetworkEvent::Stop);
        let _ = self.hub.send(HubEvent::Stop).await;
        // The connection tasks send the close frames meanwhile.
        tokio::time::sleep(CLOSE_DELAY).await;
    }
}

/// The room for topics and services of the domain: half of the descriptors. The others are for topics and services of
/// peers, for the sockets of connections, and for the program that a gateway is a part of.
fn room() -> Room {
    // If the number is unknown, declaring an interface or accepting a link tells.
    let free = sm2_io::free_descriptors(DESCRIPTORS_MAX).unwrap_or(DESCRIPTORS_MAX);
    Room {
        descriptors: free as u64 / 2,
        ..Room::UNLIMITED
    }
}

/// Joins the domain of this configuration, and serves status reports there.
fn joins(
    config: &Config,
    hub: &HubHandle,
) -> impl FnOnce() -> Result<Local, LocalError> + Send + use<> {
    let (location, name, hub) = (config.domain.clone(), config.name.clone(), hub.clone());
    let max_len_bytes = config.limits.message_bytes;
    move || {
        let domain = Local::join(location, &name, max_len_bytes, hub.clone())?;
        status::serve(&domain, &name, hub)?;
        Ok(domain)
    }
}

fn labels(config: &Config) -> ConfigLabels {
    let names = config.peers.iter().map(|it| (it.id, it.name.clone()));
    ConfigLabels {
        peers: names.collect(),
        rule_lines: config.rule_lines.clone(),
    }
}

/// Greater than the epoch of any earlier process, unless the clock was set back.
//= SM2-GWC-004
fn epoch() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |it| u64::try_from(it.as_nanos()).unwrap_or(u64::MAX))
}
