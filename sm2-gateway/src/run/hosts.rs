//! Host names of peers. Each attempt to connect looks the name up again, since addresses change.

use std::{
    collections::BTreeMap,
    io,
    net::{IpAddr, SocketAddr},
};

use super::thread::on_thread;
use crate::{
    address::LookUp,
    channel::network::{NetworkEvent, NetworkHandle},
};
use sm2_proto::gateway::GatewayId;

/// The host names of each peer.
#[derive(Debug)]
pub(super) struct Hosts {
    look_up: LookUp,
    names: BTreeMap<GatewayId, Vec<String>>,
    /// Counts the choices: the addresses of a host are tried round robin.
    choices: usize,
}

impl Hosts {
    pub(super) const fn new(look_up: LookUp) -> Self {
        Self {
            look_up,
            names: BTreeMap::new(),
            choices: 0,
        }
    }

    pub(super) fn forget(&mut self) {
        self.names.clear();
    }

    pub(super) fn add(&mut self, peer: GatewayId, host: String) {
        self.names.entry(peer).or_default().push(host);
    }

    pub(super) fn count(&self, peer: GatewayId) -> usize {
        self.names.get(&peer).map_or(0, Vec::len)
    }

    /// Starts a lookup. Each lookup leads to exactly one event, so that at most one lookup of a peer
    /// is in flight.
    pub(super) fn look_up(&self, peer: GatewayId, host: usize, network: NetworkHandle) {
        let host = self.names.get(&peer).and_then(|it| it.get(host));
        let Some(host) = host.cloned() else {
            // A reload has removed the name.
            network.send(NetworkEvent::Failed {
                peer,
                is_stale: false,
            });
            return;
        };
        let (look_up, name) = (self.look_up, host.clone());
        tokio::spawn(async move {
            let addresses = on_thread("host", move || look_up(&name)).await;
            let addresses = addresses.and_then(|it| it);
            network.send(NetworkEvent::Resolved {
                peer,
                host,
                addresses,
            });
        });
    }

    /// Chooses one of the addresses that a socket bound to `local` can reach.
    pub(super) fn choose(
        &mut self,
        peer: GatewayId,
        host: &str,
        found: io::Result<Vec<SocketAddr>>,
        local: IpAddr,
    ) -> Option<SocketAddr> {
        if !(self.names.get(&peer)).is_some_and(|it| it.iter().any(|it| it == host)) {
            return None;
        }
        let addresses: Vec<_> = match found {
            Ok(found) => found
                .into_iter()
                .filter(|it| can_reach(local, *it))
                .collect(),
            Err(error) => {
                tracing::warn!(%peer, host, %error, "cannot look up the host of a peer");
                return None;
            }
        };
        if addresses.is_empty() {
            tracing::warn!(
                %peer, host, listen = %local,
                "the host of a peer has no address that a socket at `listen` can reach"
            );
            return None;
        }
        self.choices = self.choices.wrapping_add(1);
        addresses.get(self.choices % addresses.len()).copied()
    }
}

/// An IPv6 socket reaches IPv4 addresses only if it is bound to the unspecified address.
const fn can_reach(local: IpAddr, address: SocketAddr) -> bool {
    match local {
        IpAddr::V4(_) => address.is_ipv4(),
        IpAddr::V6(local) => address.is_ipv6() || local.is_unspecified(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::system_look_up;

    const PEER: GatewayId = GatewayId([1; 32]);

    #[test]
    fn each_address_that_can_be_reached_has_its_turn() {
        let mut hosts = Hosts::new(system_look_up);
        hosts.add(PEER, "robot:1".to_owned());
        let four: SocketAddr = "192.0.2.1:1".parse().unwrap();
        let six: SocketAddr = "[2001:db8::1]:1".parse().unwrap();
        let mut chosen = |local: &str| {
            let local = local.parse().unwrap();
            let found = || Ok(vec![six, four]);
            let mut two = [(); 2].map(|()| hosts.choose(PEER, "robot:1", found(), local));
            two.sort();
            two
        };
        assert_eq!(chosen("0.0.0.0"), [Some(four); 2]);
        assert_eq!(chosen("::"), [Some(four), Some(six)]);
        assert_eq!(chosen("::1"), [Some(six); 2]);
        let mut choose = |peer, host, found| hosts.choose(peer, host, found, four.ip());
        assert_eq!(choose(PEER, "robot:1", Ok(vec![six])), None);
        assert_eq!(choose(PEER, "robot:1", Err(io::Error::other("no"))), None);
        // A peer that is not trusted, and a host that is not configured.
        assert_eq!(choose(GatewayId([2; 32]), "robot:1", Ok(vec![four])), None);
        assert_eq!(choose(PEER, "other:1", Ok(vec![four])), None);
    }
}
