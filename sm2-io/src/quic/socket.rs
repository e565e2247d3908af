//! The UDP socket, many datagrams at a time where the kernel can (GSO, GRO).

use std::{
    io::{self, IoSliceMut},
    net::SocketAddr,
};

use quinn_proto::EcnCodepoint;
use quinn_udp::{BATCH_SIZE, RecvMeta, UdpSocketState};
use tokio::{io::Interest, net::UdpSocket};

/// What the kernel keeps for a gateway that is busy.
const KERNEL_BUFFER_BYTES: usize = 4 << 20;
/// What one datagram, or several that were put together, can take.
const SLOT_BYTES: usize = 65_536;

/// A UDP socket for QUIC.
#[derive(Debug)]
pub struct Socket {
    socket: UdpSocket,
    state: UdpSocketState,
}

/// Room for what is read at a time.
#[derive(Debug)]
pub struct Batch {
    bytes: Vec<u8>,
    metas: Vec<RecvMeta>,
    count: usize,
}

impl Socket {
    /// Listens at `address`; `[::]` takes IPv4 too.
    ///
    /// # Errors
    /// The address is taken, not of this machine, or not allowed.
    ///
    /// # Panics
    /// Outside of a tokio runtime with I/O enabled.
    pub fn bind(address: SocketAddr) -> io::Result<Self> {
        let socket = std::net::UdpSocket::bind(address)?;
        let state = UdpSocketState::new((&socket).into())?;
        // A system that gives less is slower, not wrong.
        let _ = state.set_recv_buffer_size((&socket).into(), KERNEL_BUFFER_BYTES);
        let _ = state.set_send_buffer_size((&socket).into(), KERNEL_BUFFER_BYTES);
        socket.set_nonblocking(true)?;
        let socket = UdpSocket::from_std(socket)?;
        Ok(Self { socket, state })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// What `getsockname(2)` says.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// How many datagrams can be sent at a time.
    #[must_use]
    pub fn max_segments(&self) -> usize {
        self.state.max_gso_segments()
    }

    /// Sends what a connection wants to be sent. A datagram that the kernel does not take is lost,
    /// as it may be anywhere on its way.
    ///
    /// # Errors
    /// The runtime is gone.
    pub async fn send(&self, transmit: &quinn_proto::Transmit, bytes: &[u8]) -> io::Result<()> {
        let transmit = quinn_udp::Transmit {
            destination: transmit.destination,
            ecn: transmit
                .ecn
                .and_then(|it| quinn_udp::EcnCodepoint::from_bits(it as u8)),
            contents: &bytes[..transmit.size],
            segment_size: transmit.segment_size,
            src_ip: transmit.src_ip,
        };
        loop {
            self.socket.writable().await?;
            let sent = self.socket.try_io(Interest::WRITABLE, || {
                self.state.try_send((&self.socket).into(), &transmit)
            });
            match sent {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // Unreachable, too big, no such network: the connection finds out by itself.
                Ok(()) | Err(_) => return Ok(()),
            }
        }
    }

    /// Waits for datagrams.
    ///
    /// # Errors
    /// The socket is broken.
    pub async fn recv(&self, batch: &mut Batch) -> io::Result<()> {
        loop {
            self.socket.readable().await?;
            let received = self.socket.try_io(Interest::READABLE, || {
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
                // What an earlier datagram met on its way.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(error) => return Err(error),
            }
        }
    }
}

impl Batch {
    /// Room for as many datagrams as the kernel gives at a time.
    #[must_use]
    pub fn new() -> Self {
        Self {
            bytes: vec![0; BATCH_SIZE * SLOT_BYTES],
            metas: vec![RecvMeta::default(); BATCH_SIZE],
            count: 0,
        }
    }

    /// Each datagram, where it came from, and its mark of congestion.
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
