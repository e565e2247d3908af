//! Datagrams from one end of a bad link to the other, in their time and order.
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
        atomic::{AtomicBool, AtomicU32, Ordering},
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

/// How many datagrams of a socket are read before others are sent.
const BURST: usize = 64;
/// How many near addresses there are at a time: a host that moves has one after another.
const ADDRESSES_MAX: usize = 16;
/// What the kernel keeps while the thread waits for a processor.
const KERNEL_BUFFER_BYTES: usize = 8 << 20;
/// How long the end may not be noticed.
const LOOK: Duration = Duration::from_millis(20);

/// What can be changed while it runs.
#[derive(Debug, Default)]
pub(crate) struct Controls {
    pub(crate) loss_permille: AtomicU32,
    pub(crate) is_cut: AtomicBool,
}

/// What it is made of.
pub(crate) struct Options {
    pub(crate) profile: Profile,
    /// Where its sockets are, if not where the caller is.
    pub(crate) place: Option<Namespace>,
    /// Where near hosts find it; port 0 is any.
    pub(crate) near: SocketAddr,
    /// Where it takes what they send.
    pub(crate) far: SocketAddr,
    /// If nobody else limits rate and loses datagrams, the relay does.
    pub(crate) shaping: Option<Arc<Controls>>,
    /// From when pauses are counted.
    pub(crate) epoch: Instant,
}

/// A relay, until it is dropped.
///
/// It is to the far host what a router with address translation is: each near address has a far
/// port of its own, so a near host that moves is seen to move.
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
            // The caller waits for it.
            let _ = opened.send(address);
            if let Some(mut wire) = wire {
                while !until.load(Ordering::Relaxed) {
                    wire.turn();
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

    /// Its near end.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // It holds nothing that could be lost.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// One of the two ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    ToFar,
    ToNear,
}

/// A datagram on its way: which near address sent it or gets it.
struct Flying {
    near: SocketAddr,
    bytes: Vec<u8>,
}

struct Wire {
    shaping: Option<Arc<Controls>>,
    far: SocketAddr,
    near: UdpSocket,
    /// The far port of each near address, the newest last.
    away: Vec<(SocketAddr, UdpSocket)>,
    to_far: Lane<Flying>,
    to_near: Lane<Flying>,
}

impl Wire {
    /// In the thread that has it: the thread's place is the sockets' place.
    fn open(options: Options) -> io::Result<(Self, SocketAddr)> {
        if let Some(place) = &options.place {
            place.join()?;
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

    fn turn(&mut self) {
        let now = Instant::now();
        for way in [Way::ToFar, Way::ToNear] {
            while let Some(flying) = self.lane(way).pop(now) {
                self.deliver(way, &flying);
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
        // What cannot be waited for is tried.
        let _ = ppoll(&mut entries, Some(TimeSpec::from_duration(timeout)), None);
    }

    fn read(&mut self) {
        let mut buffer = [0; 2_048];
        for _ in 0..BURST {
            let Ok((len, address)) = self.near.recv_from(&mut buffer) else {
                break;
            };
            if self.ensure_away(address).is_ok() {
                self.carry(Way::ToFar, address, &buffer[..len]);
            }
        }
        for index in 0..self.away.len() {
            for _ in 0..BURST {
                let (address, socket) = &self.away[index];
                let address = *address;
                // An error is what an earlier datagram met, as it is with nobody at the far end.
                let Ok(len) = socket.recv(&mut buffer) else {
                    break;
                };
                self.carry(Way::ToNear, address, &buffer[..len]);
            }
        }
    }

    /// A far port for each near address.
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

    /// What became of one that was lost nobody knows.
    fn deliver(&self, way: Way, flying: &Flying) {
        let _ = match way {
            Way::ToNear => self.near.send_to(&flying.bytes, flying.near),
            Way::ToFar => match self.away.iter().find(|(near, _)| *near == flying.near) {
                Some((_, socket)) => socket.send(&flying.bytes),
                None => return,
            },
        };
    }

    fn carry(&mut self, way: Way, near: SocketAddr, bytes: &[u8]) {
        let now = Instant::now();
        let Some(sent) = self.shape(way, bytes.len(), now) else {
            return;
        };
        let bytes = bytes.to_vec();
        self.lane(way).push(sent, Flying { near, bytes });
    }

    /// When it has left its host, if it does.
    fn shape(&mut self, way: Way, len_bytes: usize, now: Instant) -> Option<Instant> {
        let Some(controls) = &self.shaping else {
            return Some(now);
        };
        let loss_permille = controls.loss_permille.load(Ordering::Relaxed);
        let is_cut = controls.is_cut.load(Ordering::Relaxed);
        let sent = self.lane(way).shape(now, len_bytes, loss_permille);
        sent.filter(|_| !is_cut)
    }

    const fn lane(&mut self, way: Way) -> &mut Lane<Flying> {
        match way {
            Way::ToFar => &mut self.to_far,
            Way::ToNear => &mut self.to_near,
        }
    }
}

/// One with room for what comes while others are served.
fn socket(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    // Root may have more than the system's limit; a smaller buffer is slower, not wrong.
    let _ = setsockopt(&socket, sockopt::RcvBufForce, &KERNEL_BUFFER_BYTES)
        .or_else(|_| setsockopt(&socket, sockopt::RcvBuf, &KERNEL_BUFFER_BYTES));
    let _ = setsockopt(&socket, sockopt::SndBuf, &KERNEL_BUFFER_BYTES);
    Ok(socket)
}
