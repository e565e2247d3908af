//! The relay of a lossy link, which passes datagrams between its ends with delay and in order.
#![allow(
    clippy::disallowed_types,
    reason = "settings between two threads; no process shares this memory"
)]

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    os::fd::AsFd,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use nix::{
    poll::{PollFd, PollFlags, ppoll},
    sys::{
        socket::{setsockopt, sockopt},
        time::TimeSpec,
    },
};

use crate::{lane::Lane, namespace::Namespace, profile::Profile};

/// The most datagrams of a socket that are read before due datagrams are sent.
const BURST: usize = 64;
/// The largest number of near addresses: a host that moves uses one after another.
const ADDRESSES_MAX: usize = 16;
/// The size of the sockets' buffers, for the time while the thread waits for a processor.
const KERNEL_BUFFER_BYTES: usize = 8 << 20;
/// How often the thread checks whether to end.
const LOOK: Duration = Duration::from_millis(20);

/// Settings that can change while the relay runs, and what becomes of them.
#[derive(Debug, Default)]
pub(crate) struct Controls {
    pub(crate) loss_permille: AtomicU32,
    pub(crate) is_cut: AtomicBool,
    /// The number of lost datagrams since the settings were changed.
    pub(crate) lost: AtomicU64,
}

/// The settings of a relay.
pub(crate) struct Options {
    pub(crate) profile: Profile,
    /// The namespace of its sockets; `None` is that of the caller.
    pub(crate) namespace: Option<Namespace>,
    /// The address for near hosts; port 0 is any free port.
    pub(crate) near: SocketAddr,
    /// The address of the far host.
    pub(crate) far: SocketAddr,
    /// The loss and the cut of the link, if the relay limits the rate and loses datagrams; `None` if
    /// the kernel does.
    pub(crate) shaping: Option<Arc<Controls>>,
    /// The time when the count of pauses begins.
    pub(crate) epoch: Instant,
}

/// A relay, which runs until it is dropped.
///
/// It resembles a router with address translation: each near address has a far port of its own, so
/// that the far host sees when a near host changes its address.
#[derive(Debug)]
pub(crate) struct Relay {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Relay {
    pub(crate) fn start(options: Options) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&stop);
        let (opened, answer) = mpsc::sync_channel(1);
        let thread = thread::Builder::new().name("relay".to_owned());
        let thread = thread.spawn(move || {
            let wire = Wire::open(options);
            let (wire, address) = match wire {
                Ok((wire, address)) => (Some(wire), Ok(address)),
                Err(error) => (None, Err(error)),
            };
            // The caller waits for this answer.
            let _ = opened.send(address);
            if let Some(mut wire) = wire {
                while !until.load(Ordering::Relaxed) {
                    wire.run_once();
                }
            }
        })?;
        let gone = |_| io::Error::other("the relay's thread ended");
        Ok(Self {
            address: answer.recv().map_err(gone)??,
            stop,
            thread: Some(thread),
        })
    }

    /// The address of the near end.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A panic of the thread has no further effect.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// One of the two directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    ToFar,
    ToNear,
}

/// A datagram in flight, with the near address that sent it or receives it.
struct InFlight {
    near: SocketAddr,
    bytes: Vec<u8>,
}

struct Wire {
    shaping: Option<Arc<Controls>>,
    far: SocketAddr,
    near: UdpSocket,
    /// The far socket of each near address, the newest last.
    away: Vec<(SocketAddr, UdpSocket)>,
    to_far: Lane<InFlight>,
    to_near: Lane<InFlight>,
}

impl Wire {
    /// Moves the calling thread into the namespace, and makes the near socket there.
    fn open(options: Options) -> io::Result<(Self, SocketAddr)> {
        if let Some(namespace) = &options.namespace {
            namespace.join()?;
        }
        let near = socket(options.near)?;
        let address = near.local_addr()?;
        let Options { profile, epoch, .. } = options;
        let lane = |salt| Lane::new(&profile, epoch, salt);
        let wire = Self {
            to_far: lane(1),
            to_near: lane(2),
            shaping: options.shaping,
            far: options.far,
            near,
            away: Vec::new(),
        };
        Ok((wire, address))
    }

    /// Sends all due datagrams, waits for the next event, and reads new datagrams.
    fn run_once(&mut self) {
        let now = Instant::now();
        for direction in [Direction::ToFar, Direction::ToNear] {
            while let Some(in_flight) = self.lane(direction).pop(now) {
                self.deliver(direction, &in_flight);
            }
        }
        let next = self.to_far.due().into_iter().chain(self.to_near.due());
        let next = next.map(|it| it.saturating_duration_since(now)).min();
        self.wait(next.unwrap_or(LOOK).min(LOOK));
        self.read();
    }

    fn wait(&self, timeout: Duration) {
        let away = self.away.iter().map(|(_, socket)| socket);
        let sockets = std::iter::once(&self.near).chain(away);
        let mut entries: Vec<_> = sockets
            .map(|it| PollFd::new(it.as_fd(), PollFlags::POLLIN))
            .collect();
        // If waiting fails, reading is tried at once.
        let _ = ppoll(&mut entries, Some(TimeSpec::from_duration(timeout)), None);
    }

    fn read(&mut self) {
        let mut buffer = [0; 2_048];
        for _ in 0..BURST {
            let Ok((len, address)) = self.near.recv_from(&mut buffer) else {
                break;
            };
            if self.ensure_away(address).is_ok() {
                self.carry(Direction::ToFar, address, &buffer[..len]);
            }
        }
        for index in 0..self.away.len() {
            for _ in 0..BURST {
                let (address, socket) = &self.away[index];
                let address = *address;
                // An error belongs to an earlier datagram, for example if no socket listens at the far
                // end.
                let Ok(len) = socket.recv(&mut buffer) else {
                    break;
                };
                self.carry(Direction::ToNear, address, &buffer[..len]);
            }
        }
    }

    /// Makes the far socket of a near address, if there is none.
    fn ensure_away(&mut self, near: SocketAddr) -> io::Result<()> {
        if self.away.iter().any(|(it, _)| *it == near) {
            return Ok(());
        }
        let any = match self.far {
            SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = socket(SocketAddr::new(any, 0))?;
        socket.connect(self.far)?;
        if self.away.len() == ADDRESSES_MAX {
            self.away.remove(0);
        }
        self.away.push((near, socket));
        Ok(())
    }

    /// Sends a datagram to its destination. Errors are ignored: the datagram is lost, as on any link.
    fn deliver(&self, direction: Direction, in_flight: &InFlight) {
        let _ = match direction {
            Direction::ToNear => self.near.send_to(&in_flight.bytes, in_flight.near),
            Direction::ToFar => match self.away.iter().find(|(near, _)| *near == in_flight.near) {
                Some((_, socket)) => socket.send(&in_flight.bytes),
                None => return,
            },
        };
    }

    fn carry(&mut self, direction: Direction, near: SocketAddr, bytes: &[u8]) {
        let now = Instant::now();
        let Some(sent) = self.shape(direction, bytes.len(), now) else {
            return;
        };
        let bytes = bytes.to_vec();
        self.lane(direction).push(sent, InFlight { near, bytes });
    }

    /// The time when a datagram has left its host; `None` if it is lost.
    fn shape(&mut self, direction: Direction, len_bytes: usize, now: Instant) -> Option<Instant> {
        let Some(controls) = &self.shaping else {
            return Some(now);
        };
        let loss_permille = controls.loss_permille.load(Ordering::Relaxed);
        let is_cut = controls.is_cut.load(Ordering::Relaxed);
        let controls = Arc::clone(controls);
        let sent = self.lane(direction).shape(now, len_bytes, loss_permille);
        let sent = sent.filter(|_| !is_cut);
        if sent.is_none() {
            controls.lost.fetch_add(1, Ordering::Relaxed);
        }
        sent
    }

    const fn lane(&mut self, direction: Direction) -> &mut Lane<InFlight> {
        match direction {
            Direction::ToFar => &mut self.to_far,
            Direction::ToNear => &mut self.to_near,
        }
    }
}

/// A socket with large buffers, for datagrams that arrive while the thread handles other sockets.
fn socket(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    // Only root may exceed the system's limit. A smaller buffer loses more datagrams, which is legal.
    let _ = setsockopt(&socket, sockopt::RcvBufForce, &KERNEL_BUFFER_BYTES)
        .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &KERNEL_BUFFER_BYTES));
    let _ = setsockopt(&socket, sockopt::SndBuf, &KERNEL_BUFFER_BYTES);
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use nix::sys::socket::getsockopt;

    use super::*;

    /// A thread that waits for a processor finds the datagrams that have come meanwhile.
    #[test]
    fn a_socket_has_no_smaller_buffers_than_the_system_gives() {
        let any = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0);
        let [plain, large] = [UdpSocket::bind(any), socket(any)].map(Result::unwrap);
        let received = [&plain, &large].map(|it| getsockopt(it, sockopt::RcvBuf).unwrap());
        let sent = [&plain, &large].map(|it| getsockopt(it, sockopt::SndBuf).unwrap());
        for [plain, large] in [received, sent] {
            assert!(large >= plain, "{large} bytes, {plain} by default");
        }
    }
}
