//! Two domains with a bad link between their gateways.

use std::{
    io::{self, Write},
    net::SocketAddr,
    sync::{Mutex, MutexGuard, PoisonError},
};

use sm2_gateway::Gateway;
use sm2_lossy_link::{LossyLink, Profile, Side, Unavailable};
use sm2_test_support::{skip, skip_without, until};
use tokio::runtime::Runtime;

use crate::common::{ALL, Domain, report, runtime};

/// Serializes the tests that generate much traffic, so that they do not disturb each other.
static ALONE: Mutex<()> = Mutex::new(());

/// Waits until no other test generates much traffic.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Prints a line, even in runs that hide the output of passing tests.
pub(crate) fn say(text: &str) {
    // Standard error may be closed.
    let _ = writeln!(io::stderr(), "{text}");
}

/// Makes a link of namespaces. Where that is not possible, reports the reason and returns `None`,
/// and the test has nothing to check.
pub(crate) fn link(profile: Profile) -> Option<LossyLink> {
    LossyLink::namespaces(profile)
        .inspect_err(|reason| match reason {
            Unavailable::Missing(program) => skip_without(program, reason),
            Unavailable::Failed { .. } | Unavailable::NotRoot | Unavailable::System(_) => {
                skip(format_args!("no bad link: {reason}"));
            }
        })
        .ok()
}

pub(crate) struct World {
    pub(crate) left: Gateway,
    pub(crate) right: Gateway,
    pub(crate) near: Domain,
    pub(crate) far: Domain,
    pub(crate) runtime: Runtime,
    pub(crate) link: LossyLink,
}

impl World {
    /// Starts two gateways that trust each other.
    pub(crate) fn new(mut link: LossyLink) -> Self {
        let (near, far) = (Domain::new("near"), Domain::new("far"));
        let runtime = runtime();
        let start = |link: &LossyLink, side, peer: (&Domain, Option<SocketAddr>)| {
            let domain = if side == Side::Near { &near } else { &far };
            let config = domain.config_at(&link.listen().to_string(), &[peer], ALL);
            let started = link.enter(side, || runtime.block_on(Gateway::start(&config)));
            started.unwrap().unwrap()
        };
        let right = start(&link, Side::Far, (&near, None));
        let way = link.connect(right.address()).unwrap();
        let left = start(&link, Side::Near, (&far, Some(way)));
        let world = Self {
            left,
            right,
            near,
            far,
            runtime,
            link,
        };
        until("connected", || world.peer_address().is_some());
        world
    }

    /// The address that the far gateway sees of the near one, if they are connected.
    pub(crate) fn peer_address(&self) -> Option<String> {
        let peers = report(&self.runtime, &self.right).peers;
        peers.first().and_then(|it| it.address.clone())
    }

    pub(crate) fn stop(self) {
        let Self {
            left,
            right,
            runtime,
            ..
        } = self;
        runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
    }
}
