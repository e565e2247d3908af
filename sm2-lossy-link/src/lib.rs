//! A lossy link between two hosts on this machine, for tests and demos. It has a limited rate, random
//! loss, delay, jitter and pauses.
//!
//! | kind | hosts | rate and loss | requirements |
//! | --- | --- | --- | --- |
//! | [`Kind::Namespaces`] | two network namespaces | `tc` and `nft` of the kernel | root, `ip`, `tc`, `nft` |
//! | [`Kind::Relay`] | the loopback interface | a relay in this process | none |
//!
//! In both kinds, a relay adds delay, jitter and pauses. To use a link:
//!
//! 1. [`LossyLink::open`] makes the link.
//! 2. Make the sockets and processes of the far host within [`LossyLink::enter`].
//! 3. [`LossyLink::connect`] to the UDP address of the far host yields the address for the near host.
//! 4. Make the sockets and processes of the near host within [`LossyLink::enter`].
//!
//! The namespaces have no names: the kernel removes them when the link is dropped or the process ends.
//!
//! # Why namespaces
//!
//! The kernels' own queues and routes take part: the rate is that of `tbf`, and nftables drops one datagram at a time,
//! after a batch that was sent as one is split. Nothing is left behind even after `kill -9`, because the namespaces are
//! descriptors of this process alone. A thread that has entered a namespace creates the gateway's UDP socket; Managers
//! and nodes stay outside, because they are connected by paths. `sm2-bench run bad-link` turns the middle namespace
//! into a router whose packets all pass a TUN device, so that TCP takes the same path as QUIC. The crate depends on no
//! other one of SM2, so that the tests of `sm2-gateway`, the benchmarks and the demo use it without a cycle.

mod lane;
mod namespace;
mod network;
mod pauses;
mod profile;
mod random;
mod relay;

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::{Arc, Mutex, PoisonError, atomic::Ordering},
    time::Instant,
};

pub use self::{
    lane::{HEADERS_BYTES, Lane},
    namespace::Namespace,
    network::{DEVICE, Unavailable, host_address},
    pauses::Pause,
    profile::{Profile, Side},
};
use self::{
    network::Network,
    relay::{Controls, Options, Relay},
};

/// The implementation of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Network namespaces of Linux.
    Namespaces,
    /// A relay on loopback.
    Relay,
}

impl Kind {
    /// The name of the kind in reports.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Namespaces => "namespaces",
            Self::Relay => "relay",
        }
    }
}

/// A lossy link, which exists until it is dropped.
#[derive(Debug)]
pub struct LossyLink {
    profile: Profile,
    relays: Vec<Relay>,
    medium: Medium,
    /// The current loss in permille, and whether the link is cut.
    now: Mutex<(u32, bool)>,
    epoch: Instant,
}

#[derive(Debug)]
enum Medium {
    Namespaces(Network),
    Relay(Arc<Controls>),
}

impl LossyLink {
    /// Makes a link of namespaces if possible. Otherwise makes a relay, and returns the reason.
    #[must_use]
    pub fn open(profile: Profile) -> (Self, Option<Unavailable>) {
        match Self::namespaces(profile.clone()) {
            Ok(link) => (link, None),
            Err(reason) => (Self::relay(profile), Some(reason)),
        }
    }

    /// Makes a link of three namespaces: two hosts, and the network between them.
    ///
    /// # Errors
    /// See [`Unavailable`].
    pub fn namespaces(profile: Profile) -> Result<Self, Unavailable> {
        let network = Network::new(&profile)?;
        Ok(Self::new(profile, Medium::Namespaces(network)))
    }

    /// Makes a link whose hosts both use the loopback interface.
    #[must_use]
    pub fn relay(profile: Profile) -> Self {
        let controls = Controls::default();
        let loss = profile.loss_permille;
        controls.loss_permille.store(loss, Ordering::Relaxed);
        Self::new(profile, Medium::Relay(Arc::new(controls)))
    }

    fn new(profile: Profile, medium: Medium) -> Self {
        Self {
            relays: Vec::new(),
            medium,
            now: Mutex::new((profile.loss_permille, false)),
            profile,
            epoch: Instant::now(),
        }
    }

    /// The implementation of the link.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self.medium {
            Medium::Namespaces(_) => Kind::Namespaces,
            Medium::Relay(_) => Kind::Relay,
        }
    }

    /// The properties that the link had at first.
    #[must_use]
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The network namespace of a host; `None` for a relay.
    #[must_use]
    pub const fn host(&self, side: Side) -> Option<&Namespace> {
        match &self.medium {
            Medium::Namespaces(network) => Some(network.host(side)),
            Medium::Relay(_) => None,
        }
    }

    /// The network between the hosts; `None` for a relay. It has the interfaces `near` and `far`, and
    /// does not forward packets between them unless the caller adds routes.
    #[must_use]
    pub const fn between(&self) -> Option<&Namespace> {
        match &self.medium {
            Medium::Namespaces(network) => Some(&network.link),
            Medium::Relay(_) => None,
        }
    }

    /// Calls `work` at a host: sockets and processes that it makes belong to the host's network.
    ///
    /// # Errors
    /// See [`Namespace::enter`].
    ///
    /// # Panics
    /// If the work does.
    pub fn enter<T: Send>(&self, side: Side, work: impl FnOnce() -> T + Send) -> io::Result<T> {
        match self.host(side) {
            Some(host) => host.enter(work),
            None => Ok(work()),
        }
    }

    /// The address where hosts listen, with any port. In a namespace it covers all addresses of the
    /// host, so that the host may change its address.
    #[must_use]
    pub const fn listen(&self) -> SocketAddr {
        let ip = match self.medium {
            Medium::Namespaces(_) => Ipv4Addr::UNSPECIFIED,
            Medium::Relay(_) => Ipv4Addr::LOCALHOST,
        };
        SocketAddr::new(std::net::IpAddr::V4(ip), 0)
    }

    /// Returns the address that leads the near host to `far`, a UDP address of the far host, over
    /// the link. With [`Kind::Relay`], each such connection has the full rate of the link.
    ///
    /// # Errors
    /// A socket or a thread cannot be made.
    pub fn connect(&mut self, far: SocketAddr) -> io::Result<SocketAddr> {
        let (namespace, near, far, shaping) = match &self.medium {
            Medium::Namespaces(network) => {
                let ip = network::link_address(Side::Near, far.is_ipv6());
                let far = network::from_outside(far, Side::Far);
                (Some(network.link.clone()), ip, far, None)
            }
            Medium::Relay(controls) => {
                let ip = Ipv4Addr::LOCALHOST.into();
                (None, ip, far, Some(Arc::clone(controls)))
            }
        };
        let relay = Relay::start(Options {
            profile: self.profile.clone(),
            namespace,
            near: SocketAddr::new(near, 0),
            far,
            shaping,
            epoch: self.epoch,
        })?;
        let address = relay.address();
        self.relays.push(relay);
        Ok(address)
    }

    /// Sets the random loss in both directions, in percent of datagrams.
    ///
    /// # Errors
    /// `nft` has failed.
    pub fn set_loss(&self, percent: f64) -> Result<(), Unavailable> {
        self.change(|now| now.0 = (percent.clamp(0.0, 100.0) * 10.0).round() as u32)
    }

    /// Cuts the link: all datagrams are lost.
    ///
    /// # Errors
    /// `nft` has failed.
    pub fn cut(&self) -> Result<(), Unavailable> {
        self.change(|now| now.1 = true)
    }

    /// Restores the link after [`cut`](Self::cut).
    ///
    /// # Errors
    /// `nft` has failed.
    pub fn restore(&self) -> Result<(), Unavailable> {
        self.change(|now| now.1 = false)
    }

    /// The number of datagrams that were lost at random or by a cut, in both directions, since the last change of the
    /// link. A relay also counts those that found the queue full. With a loss of 0, namespaces count nothing.
    ///
    /// # Errors
    /// `nft` has failed.
    pub fn lost(&self) -> Result<u64, Unavailable> {
        match &self.medium {
            Medium::Namespaces(network) => network.lost(),
            Medium::Relay(controls) => Ok(controls.lost.load(Ordering::Relaxed)),
        }
    }

    fn change(&self, change: impl FnOnce(&mut (u32, bool))) -> Result<(), Unavailable> {
        let mut now = self.now.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut now);
        let (loss_permille, is_cut) = *now;
        match &self.medium {
            Medium::Namespaces(network) => network.lose(loss_permille, is_cut),
            Medium::Relay(controls) => {
                controls
                    .loss_permille
                    .store(loss_permille, Ordering::Relaxed);
                controls.is_cut.store(is_cut, Ordering::Relaxed);
                controls.lost.store(0, Ordering::Relaxed);
                Ok(())
            }
        }
    }
}
