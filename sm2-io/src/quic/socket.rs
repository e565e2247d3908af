//! The UDP socket, with many datagrams per system call where the kernel supports it (GSO, GRO).
//!
//! A gateway has a socket for each peer to send with. A link that takes no datagrams fills the send buffer of a socket,
//! and the next send waits: with one socket, eight stuck links silenced all other peers. The sockets share their
//! address (`SO_REUSEPORT`), and a filter of one instruction lets the first of them receive everything. The first one
//! is bound before it gets the option, so a second gateway still finds the address in use.

use std::{
    io::{self, IoSliceMut},
    net::SocketAddr,
};

use quinn_proto::EcnCodepoint;
use quinn_udp::{BATCH_SIZE, RecvMeta, UdpSocketState};
use tokio::{io::Interest, net::UdpSocket};

use crate::syscall::sockets::{
    network_namespace, receive_with_first, set_option, sockopt, udp_at_shared_address,
};
use crate::syscall::{Call, guard};

/// The size of the kernel's buffers, for times when the gateway is busy.
const KERNEL_BUFFER_BYTES: usize = 4 << 20;
/// The longest datagram, or several that the kernel coalesced.
const SLOT_BYTES: usize = 65_536;

/// A UDP socket for QUIC.
#[derive(Debug)]
pub struct Socket {
    socket: UdpSocket,
    state: UdpSocketState,
    /// Whether other sockets of this process can have the same address.
    shares_address: bool,
}

/// A buffer for the datagrams of one system call.
#[derive(Debug)]
pub struct Batch {
    bytes: Vec<u8>,
    metas: Vec<RecvMeta>,
    count: usize,
}

impl Socket {
    /// Binds `address`; `[::]` receives IPv4 as well.
    ///
    /// # Errors
    /// The address is in use, does not belong to this machine, or is not allowed.
    ///
    /// # Panics
    /// Outside of a tokio runtime with I/O enabled.
    pub fn bind(address: SocketAddr) -> io::Result<Self> {
        guard(Call::UdpBind)?;
        let socket = std::net::UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        // After `bind`, so that two gateways cannot have the same address.
        let shares_address = share_address(&socket).is_ok();
        Self::new(socket, shares_address)
    }

    /// Returns another socket with the same address, which has a send buffer of its own. It receives nothing: all
    /// datagrams arrive at this one. A link that takes no datagrams fills one send buffer only.
    ///
    /// # Errors
    /// `Unsupported` if the kernel does not let sockets share this address, or if the calling thread is in another
    /// network namespace than this socket; too many descriptors; no memory.
    ///
    /// # Panics
    /// Outside of a tokio runtime with I/O enabled.
    pub fn sender(&self) -> io::Result<Self> {
        if !self.shares_address {
            return Err(io::ErrorKind::Unsupported.into());
        }
        let socket = udp_at_shared_address(self.local_addr()?)?;
        if network_namespace(&socket)? != network_namespace(&self.socket)? {
            let text = "this thread is in another network namespace than the socket";
            return Err(io::Error::new(io::ErrorKind::Unsupported, text));
        }
        Self::new(socket.into(), false)
    }

    fn new(socket: std::net::UdpSocket, shares_address: bool) -> io::Result<Self> {
        let state = UdpSocketState::new((&socket).into())?;
        // Smaller buffers are slower, but correct.
        let _ = state.set_recv_buffer_size((&socket).into(), KERNEL_BUFFER_BYTES);
        let _ = state.set_send_buffer_size((&socket).into(), KERNEL_BUFFER_BYTES);
        Ok(Self {
            socket: UdpSocket::from_std(socket)?,
            state,
            shares_address,
        })
    }

    /// The local address.
    ///
    /// # Errors
    /// Any error of `getsockname(2)`.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// The number of datagrams that one system call can send.
    #[must_use]
    pub fn max_segments(&self) -> usize {
        self.state.max_gso_segments()
    }

    /// Sends the datagrams of a connection. If the kernel refuses them, returns its error: they are lost, like
    /// datagrams that the network drops.
    ///
    /// # Errors
    /// The runtime has shut down.
    pub async fn send(
        &self,
        transmit: &quinn_proto::Transmit,
        bytes: &[u8],
    ) -> io::Result<Option<io::Error>> {
        loop {
            self.socket.writable().await?;
            match self.try_send(transmit, bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // Unreachable, too big, no such network: the connection detects the loss.
                refused => return Ok(refused.err()),
            }
        }
    }

    /// Sends datagrams, but never waits.
    ///
    /// # Errors
    /// `WouldBlock` if the send buffer is full; any error of `sendmsg(2)`. The datagrams are lost.
    pub fn try_send(&self, transmit: &quinn_proto::Transmit, bytes: &[u8]) -> io::Result<()> {
        let transmit = quinn_udp::Transmit {
            destination: transmit.destination,
            ecn: transmit
                .ecn
                .and_then(|it| quinn_udp::EcnCodepoint::from_bits(it as u8)),
            contents: &bytes[..transmit.size],
            segment_size: transmit.segment_size,
            src_ip: transmit.src_ip,
        };
        self.socket.try_io(Interest::WRITABLE, || {
            guard(Call::UdpSend)?;
            self.state.try_send((&self.socket).into(), &transmit)
        })
    }

    /// Waits for datagrams.
    ///
    /// # Errors
    /// Any other error of `recvmmsg(2)`.
    pub async fn recv(&self, batch: &mut Batch) -> io::Result<()> {
        loop {
            self.socket.readable().await?;
            let received = self.socket.try_io(Interest::READABLE, || {
                guard(Call::UdpRecv)?;
                let mut slots: Vec<_> = batch
                    .bytes
                    .chunks_mut(SLOT_BYTES)
                    .map(IoSliceMut::new)
                    .collect();
                (self.state).recv((&self.socket).into(), &mut slots, &mut batch.metas)
            });
            match received {
                Ok(count) => {
                    batch.count = count;
                    return Ok(());
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // An ICMP error for an earlier datagram.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// Lets further sockets of this user have the address, and makes this one receive all datagrams.
fn share_address(socket: &std::net::UdpSocket) -> io::Result<()> {
    set_option(socket, sockopt::ReusePort, &true)?;
    // The kernel takes the program only while another socket has the address.
    let _other = udp_at_shared_address(socket.local_addr()?)?;
    Ok(receive_with_first(socket)?)
}

impl Batch {
    /// A buffer for the most datagrams that one system call returns.
    #[must_use]
    pub fn new() -> Self {
        Self {
            bytes: vec![0; BATCH_SIZE * SLOT_BYTES],
            metas: vec![RecvMeta::default(); BATCH_SIZE],
            count: 0,
        }
    }

    /// Each datagram with its source address and ECN mark.
    pub fn datagrams(&self) -> impl Iterator<Item = (SocketAddr, Option<EcnCodepoint>, &[u8])> {
        let slots = self.bytes.chunks(SLOT_BYTES).zip(&self.metas);
        slots.take(self.count).flat_map(|(slot, meta)| {
            let ecn = meta.ecn.and_then(|it| EcnCodepoint::from_bits(it as u8));
            let datagrams = slot[..meta.len].chunks(meta.stride.max(1));
            datagrams.map(move |bytes| (meta.addr, ecn, bytes))
        })
    }
}

impl Default for Batch {
    fn default() -> Self {
        Self::new()
    }
}
