//! A bad link on this machine, for tests and demos: it carries so much, loses some, takes its time, and
//! stands still every so often.
//!
//! | kind | what it is | what it needs |
//! | --- | --- | --- |
//! | [`Kind::Namespaces`] | two hosts with an IP stack each; the kernel limits and loses | root, `ip`, `tc`, `nft` |
//! | [`Kind::Relay`] | a relay on loopback that limits and loses by itself | nothing |
//!
//! In both, a relay adds delay, jitter and pauses. First [`BadLink::open`]; then whatever is at the far host, made
//! within [`BadLink::enter`]; then [`BadLink::connect`] to its UDP address; then the near host's. Namespaces
//! have no names: they are gone with the link, or with the process, however it ends.

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

/// What a link is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Network namespaces of Linux.
    Namespaces,
    /// A relay on loopback.
    Relay,
}

impl Kind {
    /// One word for reports.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Namespaces => "namespaces",
            Self::Relay => "relay",
        }
    }
}

/// A bad link, until it is dropped.
#[derive(Debug)]
pub struct BadLink {
    profile: Profile,
    relays: Vec<Relay>,
    medium: Medium,
    /// What is lost now, and whether it is cut.
    now: Mutex<(u32, bool)>,
    epoch: Instant,
}

#[derive(Debug)]
enum Medium {
    Namespaces(Network),
    Relay(Arc<Controls>),
}

impl BadLink {
    /// Of namespaces where it can be, else of a relay; and then why.
    #[must_use]
    pub fn open(profile: Profile) -> (Self, Option<Unavailable>) {
        match Self::namespaces(profile.clone()) {
            Ok(link) => (link, None),
            Err(reason) => (Self::relay(profile), Some(reason)),
        }
    }

    /// Two hosts and what is between them, each with a network of its own.
    ///
    /// # Errors
    /// See [`Unavailable`].
    pub fn namespaces(profile: Profile) -> Result<Self, Unavailable> {
        let network = Network::new(&profile)?;
        Ok(Self::new(profile, Medium::Namespaces(network)))
    }

    /// Both hosts are this machine.
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

    /// What it is made of.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self.medium {
            Medium::Namespaces(_) => Kind::Namespaces,
            Medium::Relay(_) => Kind::Relay,
        }
    }

    /// How it was at first.
    #[must_use]
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// A host's network, if it has one of its own.
    #[must_use]
    pub const fn host(&self, side: Side) -> Option<&Namespace> {
        match &self.medium {
            Medium::Namespaces(network) => Some(network.host(side)),
            Medium::Relay(_) => None,
        }
    }

    /// The network between the hosts, if there is one: an interface `near`, an interface `far`, and
    /// nothing that goes from one to the other unless somebody adds it.
    #[must_use]
    pub const fn between(&self) -> Option<&Namespace> {
        match &self.medium {
            Medium::Namespaces(network) => Some(&network.link),
            Medium::Relay(_) => None,
        }
    }

    /// Does some work at a host: what sockets it makes and what processes it starts stay there.
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

    /// Where hosts listen; the port is any. A host may move: it listens at all of its addresses.
    #[must_use]
    pub const fn listen(&self) -> SocketAddr {
        let ip = match self.medium {
            Medium::Namespaces(_) => Ipv4Addr::UNSPECIFIED,
            Medium::Relay(_) => Ipv4Addr::LOCALHOST,
        };
        SocketAddr::new(std::net::IpAddr::V4(ip), 0)
    }

    /// Where near hosts reach `far`, a UDP address of the far host, over the link. In a relay each such way
    /// has the link's rate for itself.
    ///
    /// # Errors
    /// There are no sockets or no threads.
    pub fn connect(&mut self, far: SocketAddr) -> io::Result<SocketAddr> {
        let (place, near, far, shaping) = match &self.medium {
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
            place,
            near: SocketAddr::new(near, 0),
            far,
            shaping,
            epoch: self.epoch,
        })?;
        let address = relay.address();
        self.relays.push(relay);
        Ok(address)
    }

    /// Loses so many of a hundred datagrams each way from now on.
    ///
    /// # Errors
    /// `nft` does not do it.
    pub fn set_loss(&self, percent: f64) -> Result<(), Unavailable> {
        self.change(|now| now.0 = (percent.clamp(0.0, 100.0) * 10.0).round() as u32)
    }

    /// Lets nothing through.
    ///
    /// # Errors
    /// `nft` does not do it.
    pub fn cut(&self) -> Result<(), Unavailable> {
        self.change(|now| now.1 = true)
    }

    /// As it was before it was cut.
    ///
    /// # Errors
    /// `nft` does not do it.
    pub fn restore(&self) -> Result<(), Unavailable> {
        self.change(|now| now.1 = false)
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
                Ok(())
            }
        }
    }
}
