//! Control messages (`cmsg(3)`) as bytes: building the one that carries
//! descriptors, walking those that the kernel wrote.
//!
//! No `unsafe` here: a control buffer is zeroed, aligned memory, and headers
//! are read and written field by field. Turning a number into an owned
//! descriptor happens in `socket`, where the kernel's promise is known.

use std::mem::size_of;
use std::os::fd::{AsRawFd, BorrowedFd, RawFd};

use nix::libc;

/// The most descriptors that the kernel passes with one datagram (`SCM_MAX_FD`).
pub(crate) const MAX_FDS: usize = 253;

/// The kernel aligns headers and data to this many bytes (`CMSG_ALIGN`).
const ALIGN: usize = size_of::<usize>();
/// `cmsg_len` (a `size_t`; on musl padded to 64 bits), `cmsg_level`, `cmsg_type`.
const HEADER: usize = align(size_of::<libc::cmsghdr>());

const fn align(len: usize) -> usize {
    (len + ALIGN - 1) & !(ALIGN - 1)
}

/// The bytes that a control message with `len` bytes of data takes.
const fn space(len: usize) -> usize {
    HEADER + align(len)
}

/// Bytes for the most descriptors that a datagram can carry, and for the small other messages
/// (credentials, pidfd, time stamps) that the options of a foreign socket may add. The kernel
/// therefore never truncates the control data for lack of space.
const ROOM: usize = space(MAX_FDS * size_of::<RawFd>()) + 256;

/// A buffer for control messages. It starts zeroed, so that padding which the kernel skips is
/// initialised too.
#[repr(C, align(8))]
pub(crate) struct ControlBuffer([u8; ROOM]);

impl ControlBuffer {
    pub(crate) const ROOM: usize = ROOM;

    /// A buffer to receive into.
    pub(crate) const fn empty() -> Self {
        Self([0; ROOM])
    }

    /// One `SCM_RIGHTS` message with `fds`, and its length in bytes.
    ///
    /// `None` if there are more than [`MAX_FDS`].
    pub(crate) fn rights(fds: &[BorrowedFd<'_>]) -> Option<(Self, usize)> {
        if fds.len() > MAX_FDS {
            return None;
        }
        let mut control = Self::empty();
        let data_len = size_of_val(fds);
        let header = Header {
            len: HEADER + data_len,
            level: libc::SOL_SOCKET,
            kind: libc::SCM_RIGHTS,
        };
        header.write(&mut control.0[..HEADER]);
        let data = control.0[HEADER..HEADER + data_len].chunks_exact_mut(size_of::<RawFd>());
        for (bytes, fd) in data.zip(fds) {
            bytes.copy_from_slice(&fd.as_raw_fd().to_ne_bytes());
        }
        Some((control, space(data_len)))
    }

    pub(crate) const fn as_mut_ptr(&mut self) -> *mut libc::c_void {
        self.0.as_mut_ptr().cast()
    }

    /// The messages in the first `len` bytes, the length that the kernel reported.
    pub(crate) fn messages(&self, len: usize) -> ControlMessages<'_> {
        ControlMessages {
            rest: &self.0[..len.min(ROOM)],
        }
    }
}

/// The fixed part of a control message.
struct Header {
    len: usize,
    level: libc::c_int,
    kind: libc::c_int,
}

impl Header {
    const LEVEL: usize = std::mem::offset_of!(libc::cmsghdr, cmsg_level);
    const KIND: usize = std::mem::offset_of!(libc::cmsghdr, cmsg_type);

    fn write(&self, bytes: &mut [u8]) {
        // For the kernel `cmsg_len` is a `size_t` at offset 0; where a C library
        // declares it narrower, padding follows or precedes by endianness.
        bytes[..size_of::<usize>()].copy_from_slice(&self.len.to_ne_bytes());
        bytes[Self::LEVEL..Self::LEVEL + 4].copy_from_slice(&self.level.to_ne_bytes());
        bytes[Self::KIND..Self::KIND + 4].copy_from_slice(&self.kind.to_ne_bytes());
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        Some(Self {
            len: usize::from_ne_bytes(*bytes.first_chunk()?),
            level: libc::c_int::from_ne_bytes(*bytes.get(Self::LEVEL..)?.first_chunk()?),
            kind: libc::c_int::from_ne_bytes(*bytes.get(Self::KIND..)?.first_chunk()?),
        })
    }
}

/// One control message: its type and its data.
pub(crate) struct ControlMessage<'a> {
    kind: libc::c_int,
    data: &'a [u8],
}

impl ControlMessage<'_> {
    /// `SCM_PIDFD` (Linux 6.5), which libc does not name yet.
    const SCM_PIDFD: libc::c_int = 4;

    /// Whether it carries the descriptors that the sender passed.
    pub(crate) const fn is_rights(&self) -> bool {
        self.kind == libc::SCM_RIGHTS
    }

    /// The descriptors of this message; none for a type that carries no descriptors.
    pub(crate) fn fds(&self) -> impl ExactSizeIterator<Item = RawFd> {
        let data = match self.kind {
            libc::SCM_RIGHTS | Self::SCM_PIDFD => self.data,
            _ => &[],
        };
        data.chunks_exact(size_of::<RawFd>())
            .map(|bytes| RawFd::from_ne_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }
}

/// Iterates over the control messages of level `SOL_SOCKET`.
pub(crate) struct ControlMessages<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for ControlMessages<'a> {
    type Item = ControlMessage<'a>;

    fn next(&mut self) -> Option<ControlMessage<'a>> {
        loop {
            let header = Header::read(self.rest)?;
            let data = self.rest.get(HEADER..header.len)?;
            self.rest = self.rest.get(align(header.len)..).unwrap_or_default();
            if header.level == libc::SOL_SOCKET {
                let kind = header.kind;
                return Some(ControlMessage { kind, data });
            }
        }
    }
}
