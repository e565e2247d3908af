//! A bad link between two sockets of this machine: it carries so much, loses some, and takes its time.

use std::{
    cmp::Reverse,
    collections::BinaryHeap,
    io,
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    os::fd::AsFd,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use crate::wait::{For, wait};

/// How the link is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// What it carries each way, in bits per second, IP and UDP headers included.
    pub(super) rate_bit: f64,
    /// How many datagrams of a thousand are lost each way.
    pub(super) loss_permille: u32,
    /// How long one takes at least.
    pub(super) delay: Duration,
    /// How much longer at most.
    pub(super) jitter: Duration,
    /// How long a datagram may wait for those before it: later ones are lost.
    pub(super) queue: Duration,
}

/// Bytes of IP and UDP headers.
const HEADERS_BYTES: usize = 28;
/// How many datagrams are read before others are sent.
const BURST: usize = 64;

/// The link, until it is dropped.
pub(super) struct Relay {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Relay {
    /// Whatever comes to its address goes to `far`, and back.
    pub(super) fn start(link: Link, far: SocketAddr) -> io::Result<Self> {
        let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let away = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        away.connect(far)?;
        near.set_nonblocking(true)?;
        away.set_nonblocking(true)?;
        let address = near.local_addr()?;
        let stop = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&stop);
        let mut wire = Wire {
            link,
            sockets: [near, away],
            near: None,
            free: [Instant::now(); 2],
            arrived: [Instant::now(); 2],
            flying: BinaryHeap::new(),
            count: 0,
            random: 0x9e37_79b9_7f4a_7c15,
        };
        let thread = thread::Builder::new().name("relay".to_owned());
        let thread = thread.spawn(move || {
            while !until.load(Ordering::Relaxed) {
                wire.turn();
            }
        })?;
        Ok(Self {
            address,
            stop,
            thread: Some(thread),
        })
    }

    /// Its near end.
    pub(super) const fn address(&self) -> SocketAddr {
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

/// A datagram on its way: when it arrives, in which order it set out, and where it goes.
type Flying = (Instant, u64, usize, Vec<u8>);

struct Wire {
    link: Link,
    /// The near one, and the far one.
    sockets: [UdpSocket; 2],
    near: Option<SocketAddr>,
    /// When each way has carried all that it was given.
    free: [Instant; 2],
    /// When the last one of each way arrives: none overtakes another.
    arrived: [Instant; 2],
    flying: BinaryHeap<Reverse<Flying>>,
    count: u64,
    random: u64,
}

impl Wire {
    fn turn(&mut self) {
        let now = Instant::now();
        while let Some(Reverse((due, ..))) = self.flying.peek()
            && *due <= now
        {
            if let Some(Reverse((_, _, to, bytes))) = self.flying.pop() {
                self.deliver(to, &bytes);
            }
        }
        let next = self.flying.peek().map(|Reverse((due, ..))| *due);
        let pause = next.map_or(Duration::from_millis(20), |due| {
            due.saturating_duration_since(now)
        });
        let fds = self.sockets.each_ref().map(|it| (it.as_fd(), For::Reading));
        // What cannot be waited for is tried.
        let _ = wait(&fds, Some(pause.min(Duration::from_millis(20))));
        let mut buffer = [0; 2_048];
        for from in 0..2 {
            for _ in 0..BURST {
                let Ok((len, address)) = self.sockets[from].recv_from(&mut buffer) else {
                    break;
                };
                if from == 0 {
                    self.near = Some(address);
                }
                self.carry(1 - from, &buffer[..len]);
            }
        }
    }

    /// What became of one that was lost nobody knows.
    fn deliver(&self, to: usize, bytes: &[u8]) {
        let _ = match (to, self.near) {
            (0, Some(near)) => self.sockets[0].send_to(bytes, near),
            (0, None) => return,
            _ => self.sockets[1].send(bytes),
        };
    }

    fn carry(&mut self, to: usize, bytes: &[u8]) {
        let now = Instant::now();
        let begins = self.free[to].max(now);
        if begins - now > self.link.queue {
            return;
        }
        let bits = 8.0 * (bytes.len() + HEADERS_BYTES) as f64;
        let sent = begins + Duration::from_secs_f64(bits / self.link.rate_bit);
        self.free[to] = sent;
        if self.random() % 1_000 < u64::from(self.link.loss_permille) {
            return;
        }
        let jitter = self
            .link
            .jitter
            .mul_f64((self.random() % 1_000) as f64 / 1e3);
        let due = (sent + self.link.delay + jitter).max(self.arrived[to]);
        self.arrived[to] = due;
        self.count += 1;
        self.flying
            .push(Reverse((due, self.count, to, bytes.to_vec())));
    }

    /// An xorshift generator: what is lost is the same in each run, as far as the traffic is.
    const fn random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }
}
