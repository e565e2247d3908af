//! Sealed messages without SM2: each message is a new memfd, which is written with `pwrite`, sealed,
//! and sent to all subscribers.

use std::{
    fs::File,
    io::{self, IoSlice, IoSliceMut},
    num::NonZeroUsize,
    os::{
        fd::{AsRawFd, FromRawFd, OwnedFd},
        unix::fs::FileExt,
    },
    path::Path,
};

use nix::{
    cmsg_space,
    errno::Errno,
    fcntl::{FcntlArg, SealFlag, fcntl},
    sys::{
        memfd::{MFdFlags, memfd_create},
        mman::{MapFlags, ProtFlags, mmap, munmap},
        socket::{ControlMessage, ControlMessageOwned, MsgFlags, recv, recvmsg, sendmsg},
    },
};

use super::seqpacket::{Door, knock};
use crate::{
    clock::now_ns,
    job::Channel,
    peers::contract::{Flow, Handler},
};

/// The number of messages that a subscriber may be behind the publisher.
const AHEAD: u64 = 2;

/// The sending end.
pub struct SealedSender {
    door: Door,
    subscribers: Vec<(OwnedFd, u64)>,
    expected: usize,
    published: u64,
    buffer: Vec<u8>,
}

impl SealedSender {
    pub(super) fn new(path: &Path, channel: &Channel) -> io::Result<Self> {
        Ok(Self {
            door: Door::open(path)?,
            subscribers: Vec::new(),
            expected: channel.subscribers.max(1),
            published: 0,
            buffer: vec![0; channel.max_len],
        })
    }

    /// Accepts all waiting connections; returns the number of subscribers.
    pub(super) fn matched(&mut self) -> io::Result<usize> {
        while let Some(socket) = self.door.accept()? {
            self.subscribers.push((socket, self.published));
        }
        Ok(self.subscribers.len())
    }

    pub(super) fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> io::Result<()> {
        if self.subscribers.len() < self.expected {
            self.matched()?;
        }
        let message = &mut self.buffer[..len];
        write(message);
        let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING;
        let file = File::from(memfd_create(c"message", flags)?);
        file.write_all_at(message, 0)?;
        fcntl(&file, FcntlArg::F_ADD_SEALS(SealFlag::all()))?;
        self.published += 1;
        let needed = self.published.saturating_sub(AHEAD);
        for (socket, consumed) in &mut self.subscribers {
            while *consumed < needed {
                let mut word = [0; 8];
                if recv(socket.as_raw_fd(), &mut word, MsgFlags::empty())? == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                *consumed = u64::from_le_bytes(word);
            }
            let number = self.published.to_le_bytes();
            let fds = [file.as_raw_fd()];
            let rights = [ControlMessage::ScmRights(&fds)];
            let packet = [IoSlice::new(&number)];
            let flags = MsgFlags::MSG_NOSIGNAL;
            match sendmsg::<()>(socket.as_raw_fd(), &packet, &rights, flags, None) {
                Ok(_) | Err(Errno::EPIPE | Errno::ECONNRESET) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }
}

/// The receiving end.
pub struct SealedReceiver {
    socket: OwnedFd,
    len: usize,
}

impl SealedReceiver {
    pub(super) fn new(path: &Path, len: usize) -> io::Result<Self> {
        let socket = knock(path)?;
        Ok(Self { socket, len })
    }

    pub(super) fn pump<H: Handler>(&mut self, handler: &mut H, until_ns: u64) -> io::Result<()> {
        loop {
            let Some((number, file)) = self.take(until_ns)? else {
                crate::clock::sleep_until(until_ns);
                return Ok(());
            };
            let Some(file) = file else { return Ok(()) };
            let len = NonZeroUsize::new(self.len).ok_or(io::ErrorKind::InvalidInput)?;
            let flags = MapFlags::MAP_SHARED | MapFlags::MAP_POPULATE;
            // SAFETY: without MAP_FIXED, the kernel chooses unused addresses.
            let start = unsafe { mmap(None, len, ProtFlags::PROT_READ, flags, &file, 0)? };
            // SAFETY: the file has this length, and its seals prevent all changes.
            let message = unsafe { std::slice::from_raw_parts(start.as_ptr().cast(), self.len) };
            let flow = handler.message(message);
            // SAFETY: this is the mapping made above, and no borrow of it is left.
            unsafe { munmap(start, self.len)? };
            let packet = number.to_le_bytes();
            let packet = [IoSlice::new(&packet)];
            let flags = MsgFlags::MSG_NOSIGNAL;
            match sendmsg::<()>(self.socket.as_raw_fd(), &packet, &[], flags, None) {
                Ok(_) | Err(Errno::EPIPE | Errno::ECONNRESET) => {}
                Err(error) => return Err(error.into()),
            }
            if flow == Flow::Return {
                return Ok(());
            }
        }
    }

    /// Waits for the next message, and returns its number and file; no file if the time is over.
    /// Returns `None` if the publisher is gone.
    fn take(&self, until_ns: u64) -> io::Result<Option<(u64, Option<OwnedFd>)>> {
        loop {
            let mut number = [0; 8];
            let mut packet = [IoSliceMut::new(&mut number)];
            let mut space = cmsg_space!([i32; 1]);
            let fd = self.socket.as_raw_fd();
            let flags = MsgFlags::MSG_CMSG_CLOEXEC;
            let received = recvmsg::<()>(fd, &mut packet, Some(&mut space), flags);
            let received = match received {
                Ok(received) => received,
                Err(Errno::EAGAIN | Errno::EINTR) if now_ns() < until_ns => continue,
                Err(Errno::EAGAIN | Errno::EINTR) => return Ok(Some((0, None))),
                Err(Errno::ECONNRESET) => return Ok(None),
                Err(error) => return Err(error.into()),
            };
            if received.bytes == 0 {
                return Ok(None);
            }
            let file = received.cmsgs()?.find_map(|it| match it {
                ControlMessageOwned::ScmRights(fds) => fds.first().copied(),
                _ => None,
            });
            let file = file.ok_or(io::ErrorKind::InvalidData)?;
            // SAFETY: `recvmsg` has just returned the descriptor, and nothing else owns it.
            let file = unsafe { OwnedFd::from_raw_fd(file) };
            return Ok(Some((u64::from_le_bytes(number), Some(file))));
        }
    }
}
