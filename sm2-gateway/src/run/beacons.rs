//! Beacons: multicast datagrams over IPv6 on the configured interfaces.

use std::{
    io,
    net::{Ipv6Addr, SocketAddr, SocketAddrV6},
};

use nix::net::if_::if_nametoindex;
use sm2_proto::gateway::Beacon;
use socket2::{Domain, Protocol, Type};
use tokio::net::UdpSocket;

use crate::retry;

/// The multicast group of beacons.
//= SM2-GWD-005
const GROUP: Ipv6Addr = Ipv6Addr::new(0xff12, 0, 0, 0, 0, 0, 0x534d, 0x3247);
const PORT: u16 = 7632;

/// The socket that sends and receives beacons.
#[derive(Debug)]
pub(super) struct Beacons {
    socket: UdpSocket,
    interfaces: Vec<u32>,
}

/// Why beacons cannot be sent or received.
#[derive(Debug, thiserror::Error)]
pub enum BeaconsError {
    /// The interface does not exist.
    #[error(
        "`discovery` names the interface {name}, which does not exist: `ip link` lists the interfaces"
    )]
    NoInterface {
        /// Its name.
        name: String,
    },
    /// The system refuses multicast on the interface.
    #[error(
        "cannot use beacons on {name}: {source}; without `discovery`, peers are found at their `addresses`"
    )]
    Io {
        /// The interface.
        name: String,
        /// The error of the system.
        r#source: io::Error,
    },
}

impl Beacons {
    /// Joins the group on these interfaces. Without interfaces there are no beacons.
    pub(super) fn open(names: &[String]) -> Result<Option<Self>, BeaconsError> {
        let Some(first) = names.first() else {
            return Ok(None);
        };
        let io_error = |name: &String| {
            let name = name.clone();
            move |source| BeaconsError::Io { name, source }
        };
        let socket = bind().map_err(io_error(first))?;
        let mut interfaces = Vec::new();
        for name in names {
            let index = if_nametoindex(name.as_str());
            let index = index.map_err(|_| BeaconsError::NoInterface { name: name.clone() })?;
            socket
                .join_multicast_v6(&GROUP, index)
                .map_err(io_error(name))?;
            interfaces.push(index);
        }
        Ok(Some(Self { socket, interfaces }))
    }

    /// Sends a beacon on each interface. Errors are logged: a network may be down for a while.
    pub(super) async fn send(&self, beacon: &Beacon) {
        for interface in &self.interfaces {
            let group = SocketAddrV6::new(GROUP, PORT, 0, *interface);
            if let Err(error) = self.socket.send_to(&beacon.to_bytes(), group).await {
                tracing::debug!(%error, interface, "cannot send a beacon");
            }
        }
    }

    /// The next datagram. Without beacons it never completes.
    pub(super) async fn recv(beacons: Option<&Self>, buffer: &mut [u8]) -> (SocketAddr, usize) {
        let Some(it) = beacons else {
            return std::future::pending().await;
        };
        let mut pauses = retry::pauses();
        loop {
            match it.socket.recv_from(buffer).await {
                Ok((len, from)) => return (from, len),
                // Most errors are deferred ones of a datagram sent before.
                Err(error) => tracing::debug!(%error, "cannot receive a beacon"),
            }
            tokio::time::sleep(pauses.wait()).await;
        }
    }
}

fn bind() -> io::Result<UdpSocket> {
    let socket = socket2::Socket::new(Domain::IPV6, Type::DGRAM, Some(Protocol::UDP))?;
    // Several gateways on one machine receive the same beacons.
    socket.set_reuse_address(true)?;
    socket.set_only_v6(true)?;
    socket.set_multicast_loop_v6(true)?;
    socket.set_nonblocking(true)?;
    let any = SocketAddrV6::new(Ipv6Addr::UNSPECIFIED, PORT, 0, 0);
    socket.bind(&SocketAddr::from(any).into())?;
    UdpSocket::from_std(socket.into())
}
