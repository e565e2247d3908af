//! Seqpacket sockets. A short message is a packet. A long one is in a slot of shared memory: a
//! packet carries its number, and another packet gives the slot back.

use std::{
    io::{self, IoSlice},
    os::fd::{AsFd, AsRawFd, OwnedFd},
    path::Path,
    thread,
    time::Duration,
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, PollTimeout, poll},
    sys::{
        socket::{
            AddressFamily, Backlog, MsgFlags, SockFlag, SockType, UnixAddr, accept4, bind, connect,
            listen, recv, sendmsg, setsockopt, socket, sockopt::ReceiveTimeout,
        },
        time::TimeVal,
    },
};

use super::region::{Region, slots};
use crate::{
    clock::now_ns,
    job::Channel,
    peers::contract::{Flow, Handler},
};

/// Messages up to this length travel in the packet.
const INLINE_BYTES: usize = 4_096;

/// How often a waiting subscriber reads the clock.
const LOOK: TimeVal = TimeVal::new(0, 200_000);

/// The socket that subscribers connect to.
pub(super) struct Door(OwnedFd);

impl Door {
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let listener = seqpacket()?;
        bind(listener.as_raw_fd(), &UnixAddr::new(path)?)?;
        listen(&listener, Backlog::new(64)?)?;
        Ok(Self(listener))
    }

    /// The next connection, if one is waiting.
    pub(super) fn accept(&self) -> io::Result<Option<OwnedFd>> {
        if !readable(&self.0, 0)? {
            return Ok(None);
        }
        let fd = accept4(self.0.as_raw_fd(), SockFlag::SOCK_CLOEXEC)?;
        // SAFETY: `accept4` has just returned the descriptor, and nothing else owns it.
        Ok(Some(unsafe { std::os::fd::FromRawFd::from_raw_fd(fd) }))
    }
}

/// Connects to the publisher's socket; waits until the socket exists.
pub(super) fn knock(path: &Path) -> io::Result<OwnedFd> {
    let socket = seqpacket()?;
    let address = UnixAddr::new(path)?;
    let mut tries = 0;
    // The publisher may not have made the socket yet.
    while let Err(error) = connect(socket.as_raw_fd(), &address) {
        if !matches!(error, Errno::ENOENT | Errno::ECONNREFUSED) || tries > 10_000 {
            return Err(error.into());
        }
        tries += 1;
        thread::sleep(Duration::from_millis(1));
    }
    setsockopt(&socket, ReceiveTimeout, &LOOK)?;
    Ok(socket)
}

/// The sending end.
pub struct PacketSender {
    door: Door,
    subscribers: Vec<Subscriber>,
    /// The expected number of subscribers. While fewer are connected, each message accepts new ones.
    expected: usize,
    region: Option<Region>,
    published: u64,
    buffer: Vec<u8>,
}

struct Subscriber {
    socket: OwnedFd,
    consumed: u64,
}

fn seqpacket() -> nix::Result<OwnedFd> {
    socket(
        AddressFamily::Unix,
        SockType::SeqPacket,
        SockFlag::SOCK_CLOEXEC,
        None,
    )
}

impl PacketSender {
    pub(super) fn new(memory: &Path, path: &Path, channel: &Channel) -> io::Result<Self> {
        let len = channel.max_len;
        let region = (len > INLINE_BYTES).then(|| Region::open(memory, len, slots(len)));
        Ok(Self {
            door: Door::open(path)?,
            subscribers: Vec::new(),
            expected: channel.subscribers.max(1),
            region: region.transpose()?,
            published: 0,
            buffer: vec![0; len.min(INLINE_BYTES)],
        })
    }

    /// Accepts all waiting connections; returns the number of subscribers.
    pub(super) fn matched(&mut self) -> io::Result<usize> {
        while let Some(socket) = self.door.accept()? {
            self.subscribers.push(Subscriber {
                socket,
                consumed: self.published,
            });
        }
        Ok(self.subscribers.len())
    }

    pub(super) fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> io::Result<()> {
        if self.subscribers.len() < self.expected {
            self.matched()?;
        }
        let Some(region) = &mut self.region else {
            let message = &mut self.buffer[..len];
            write(message);
            self.published += 1;
            return send_all(&mut self.subscribers, message);
        };
        let needed = (self.published + 1).saturating_sub(region.slots() as u64);
        for subscriber in &mut self.subscribers {
            while subscriber.consumed < needed {
                let mut word = [0; 8];
                if recv(subscriber.socket.as_raw_fd(), &mut word, MsgFlags::empty())? == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                subscriber.consumed = u64::from_le_bytes(word);
            }
        }
        // SAFETY: this is the channel's only publisher, and the loop above has waited until every
        // subscriber had consumed the earlier message in the slot.
        write(unsafe { region.write(self.published, len) });
        let number = self.published.to_le_bytes();
        self.published += 1;
        send_all(&mut self.subscribers, &number)
    }
}

/// Sends to all subscribers, and forgets those that are gone.
fn send_all(subscribers: &mut Vec<Subscriber>, packet: &[u8]) -> io::Result<()> {
    let mut result = Ok(());
    subscribers.retain(|subscriber| match send(&subscriber.socket, packet) {
        Ok(()) => true,
        Err(Errno::EPIPE | Errno::ECONNRESET) => false,
        Err(error) => {
            result = Err(error.into());
            true
        }
    });
    result
}

/// Sends a packet; blocks while the socket is full.
fn send(socket: &OwnedFd, packet: &[u8]) -> nix::Result<()> {
    let packet = [IoSlice::new(packet)];
    sendmsg::<()>(
        socket.as_raw_fd(),
        &packet,
        &[],
        MsgFlags::MSG_NOSIGNAL,
        None,
    )?;
    Ok(())
}

fn readable(fd: &OwnedFd, timeout_ms: u16) -> nix::Result<bool> {
    let mut fds = [PollFd::new(fd.as_fd(), PollFlags::POLLIN)];
    match poll(&mut fds, PollTimeout::from(timeout_ms)) {
        Ok(count) => Ok(count > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The receiving end.
pub struct PacketReceiver {
    socket: OwnedFd,
    region: Option<Region>,
    len: usize,
    buffer: Vec<u8>,
}

impl PacketReceiver {
    pub(super) fn new(memory: &Path, path: &Path, len: usize) -> io::Result<Self> {
        let socket = knock(path)?;
        let region = (len > INLINE_BYTES).then(|| Region::open(memory, len, slots(len)));
        Ok(Self {
            socket,
            region: region.transpose()?,
            len,
            buffer: vec![0; len.clamp(8, INLINE_BYTES)],
        })
    }

    pub(super) fn pump<H: Handler>(&mut self, handler: &mut H, until_ns: u64) -> io::Result<()> {
        loop {
            let fd = self.socket.as_raw_fd();
            let received = match recv(fd, &mut self.buffer, MsgFlags::empty()) {
                Ok(received) => received,
                Err(Errno::EAGAIN | Errno::EINTR) if now_ns() < until_ns => continue,
                Err(Errno::EAGAIN | Errno::EINTR) => return Ok(()),
                Err(Errno::ECONNRESET) => 0,
                Err(error) => return Err(error.into()),
            };
            if received == 0 {
                // The publisher is gone, so no more messages can arrive.
                crate::clock::sleep_until(until_ns);
                return Ok(());
            }
            let flow = match &self.region {
                None => handler.message(&self.buffer[..received]),
                Some(region) => {
                    let number = self
                        .buffer
                        .first_chunk()
                        .ok_or(io::ErrorKind::InvalidData)?;
                    let number = u64::from_le_bytes(*number);
                    // SAFETY: the packet says that the message is published, and the publisher
                    // waits for this subscriber before it writes to the slot again.
                    let flow = handler.message(unsafe { region.read(number, self.len) });
                    match send(&self.socket, &(number + 1).to_le_bytes()) {
                        Ok(()) | Err(Errno::EPIPE | Errno::ECONNRESET) => flow,
                        Err(error) => return Err(error.into()),
                    }
                }
            };
            if flow == Flow::Return {
                return Ok(());
            }
        }
    }
}
