//! A gateway at work: tasks, and what goes between them.
//!
//! | task | what it has |
//! | --- | --- |
//! | `network` | the UDP socket, the endpoint, beacons, whom to dial |
//! | `connection`, one for each | QUIC, the session, the schedule and the memory of one peer |
//! | `hub` | routes, calls |
//! | `local` | the domain's nodes |
//!
//! Nobody waits for a connection: what it does not take in time is dropped, if it is a message, or
//! a datagram. So a peer that is slow, stuck or hostile harms nobody but itself.

mod beacons;
mod connection;
mod hosts;
mod hub;
mod local;
mod network;
mod shadow;
mod shared;
mod status;
mod timer;

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, Mutex},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use sm2_io::quic::{Endpoint, Socket, Trusted};
use sm2_proto::gateway::{GatewayId, Hop};
use tokio::sync::watch;

pub use self::beacons::BeaconsError;
use self::{beacons::Beacons, shared::Shared};
use crate::{
    channel::{
        self,
        hub::{ConfigLabels, HubEvent, HubHandle},
        network::{NetworkEvent, NetworkHandle},
    },
    clock::Clock,
    config::Config,
    hub::Hub,
    keys::{self, KeyFileError},
    local::{Local, LocalError},
    peer::Me,
    report::Report,
};

/// How long connections have to say goodbye.
const GOODBYE: Duration = Duration::from_millis(500);

/// Why a gateway did not start, or ended.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Its key.
    #[error(transparent)]
    Key(#[from] KeyFileError),
    /// Its domain.
    #[error(transparent)]
    Local(#[from] LocalError),
    /// The address is taken, or not of this machine.
    #[error("cannot listen at {address}: {source}; `listen` in {config} says where")]
    Listen {
        /// Which.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
        /// Where it is said.
        config: String,
    },
    /// Its beacons.
    #[error(transparent)]
    Beacons(#[from] BeaconsError),
    /// TLS does not take the key.
    #[error("the key is of no use: {0}")]
    Tls(String),
    /// The socket broke.
    #[error("the network is gone: {0}")]
    Network(io::Error),
}

/// A gateway that runs.
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
    /// Starts all of it, or nothing.
    ///
    /// # Errors
    /// See [`RunError`].
    ///
    /// # Panics
    /// Outside of a multi-threaded tokio runtime.
    pub async fn start(config: &Config) -> Result<Self, RunError> {
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
        let endpoint = endpoint.map_err(|error| RunError::Tls(error.to_string()))?;
        let hop = Hop {
            gateway: id,
            epoch: epoch(),
        };
        let (hub, hub_inbox) = channel::hub::channel();
        let (network, network_inbox) = channel::network::channel();
        let (local, local_inbox) = channel::local::channel();
        let location = config.domain.clone();
        let domain =
            tokio::task::block_in_place(|| Local::join(location, &config.name, hub.clone()))?;
        status::serve(&domain, &config.name, hub.clone())?;
        let shared = Arc::new(Shared {
            clock: Clock::of_the_machine(),
            me: Me {
                hop,
                name: config.name.clone(),
            },
            limits: config.limits,
            socket,
            hub: hub.clone(),
            network: network.clone(),
            epochs: Mutex::default(),
            shadow: Mutex::default(),
        });
        let (ending, ended) = watch::channel(None);
        tokio::spawn(local::run(domain, local_inbox));
        tokio::spawn(hub::run(
            Hub::new(hop, config.policy.clone()),
            labels(config),
            Arc::clone(&shared),
            hub_inbox,
            local,
        ));
        let (shadow, shadows) = watch::channel(None);
        tokio::spawn(shadow::run(shadows, Arc::clone(&shared)));
        let peers = config.peers.clone();
        tokio::spawn(async move {
            let network = network::Network::new(endpoint, beacons, shared, address, peers);
            let error = network.run(network_inbox).await;
            let _ = ending.send(error.err().map(Arc::new));
        });
        tracing::info!(%id, %address, name = %config.name, "the gateway is there");
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

    /// Where QUIC listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Who it is.
    #[must_use]
    pub const fn id(&self) -> GatewayId {
        self.id
    }

    /// Takes rules and peers of another configuration; its name, key, domain and addresses stay.
    //= SM2-GWR-004
    pub async fn reload(&self, config: &Config) {
        self.trusted.set(config.peers.iter().map(|it| it.id));
        // Whoever is gone meanwhile needs to be told nothing.
        self.network.send(NetworkEvent::Peers(config.peers.clone()));
        let policy = config.policy.clone();
        let labels = labels(config);
        let _ = self.hub.send(HubEvent::Reload { policy, labels }).await;
    }

    /// From now on logs what these rules and peers would change, and has it in reports: now, and
    /// when something comes that they would treat otherwise. It changes nothing.
    pub fn set_shadow(&self, config: Config) {
        self.shadow.send_replace(Some(Arc::new(config)));
    }

    /// Who is connected, and what goes to and fro.
    pub async fn report(&self) -> Option<Report> {
        self.hub.report().await.ok()
    }

    /// Answers those who ask by HTTP for `/metrics`, as long as the gateway runs: see
    /// [`metrics`](crate::metrics).
    #[cfg(feature = "metrics")]
    pub fn serve_metrics(&self, listener: tokio::net::TcpListener) {
        tokio::spawn(crate::metrics::serve(listener, self.hub.clone()));
    }

    /// Waits until it has ended by itself: the network is gone.
    pub async fn ended(&mut self) -> RunError {
        let ended = self.ended.wait_for(Option::is_some).await;
        let error = ended.ok().and_then(|it| it.clone());
        let error = error.map_or_else(
            || io::Error::other("a task of the gateway ended"),
            |it| io::Error::new(it.kind(), it.to_string()),
        );
        RunError::Network(error)
    }

    /// Says goodbye to peers and the domain.
    pub async fn stop(self) {
        self.network.send(NetworkEvent::Stop);
        let _ = self.hub.send(HubEvent::Stop).await;
        // The datagrams that say so are sent by the connections' own tasks.
        tokio::time::sleep(GOODBYE).await;
    }
}

fn labels(config: &Config) -> ConfigLabels {
    let names = config.peers.iter().map(|it| (it.id, it.name.clone()));
    ConfigLabels {
        peers: names.collect(),
        rule_lines: config.rule_lines.clone(),
    }
}

/// Greater than that of any process before, as long as the clock is not set back.
//= SM2-GWC-004
fn epoch() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |it| u64::try_from(it.as_nanos()).unwrap_or(u64::MAX))
}
