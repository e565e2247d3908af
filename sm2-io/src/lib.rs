//! SM2's adapters to the operating system: seqpacket sockets that carry descriptors, sealed memory
//! files, mappings, epoll, the socket of a domain, QUIC.
//!
//! Each adapter wraps one service of the kernel, and turns the kernel's answers into types. The
//! crate knows no frames: the machines of [`sm2_proto`] decide what a datagram means, and what to do
//! with a slow peer. [`memfd::verify`] checks each descriptor before it is mapped. The
//! callers are the drivers in `sm2-node`, `sm2-manager` and `sm2-gateway`. Linux only.
//!
//! | module | content |
//! | --- | --- |
//! | [`socket`] | [`SeqPacket`], [`Listener`]: datagrams with descriptors |
//! | [`domain_socket`] | [`socket_path`], [`BindOptions`], [`DomainSocket`]: the socket of a domain and its one owner |
//! | [`memfd`] | [`SealedLoan`], [`Preallocated`], [`Segment`]: memory to share |
//! | [`memfd::verify`] | [`InspectedFd`]: proofs about the memory of other processes |
//! | [`slots`] | [`Slot`]: the slots of a segment, each with one owner |
//! | [`mapping`] | [`SealedMapping`], [`PooledMapping`]: reading shared memory |
//! | [`ring`] | [`Ring`]: words that two processes write |
//! | [`counters`] | [`CounterPage`], [`CounterView`]: the counters of a node, readable by tools |
//! | [`epoll`] | [`Epoll`], [`wait_readable`], [`poll_now`]: waiting for descriptors |
//! | [`waker`] | [`Waker`]: waking a loop from another thread |
//! | [`latch`] | [`Latch`]: a signal that stays set |
//! | [`reusable`] | [`Reusable`]: a value that is used again once its reader has dropped it |
//! | [`timer`] | [`Timer`]: waking a loop at a given time |
//! | [`clock`] | [`now`](clock::now) |
//! | `prefetch` | memory that is about to be read or written |
//! | `quic` | QUIC between gateways (feature `quic`) |
//! | `syscall` | the seam: all system calls of this crate |
//! | `fault` | system calls that fail on request, for tests (feature `fault-injection`) |
//!
//! # Memory that other processes can change
//!
//! No safe function here returns a reference to memory that another process can change or shrink.
//! A file of another process is mapped only with a proof of its seals and size, and the mapping
//! offers what that proof allows: see [`memfd::verify`]. The programs in `tests/compile_fail` are
//! the ways around that. None of them compiles.
//!
//! # Where `unsafe` is
//!
//! All `unsafe` code of SM2 is in this crate, except for that around `PooledBytes` in `sm2-node`
//! (`src/pooled.rs`, `src/payload.rs`, `src/handle/receive.rs`). Every block says what makes it sound.
//!
//! - `syscall`: the system calls that `nix` does not make safe, and owning the descriptor that `accept4` returns.
//! - `socket`: the memory for `sendmsg` and `recvmsg`, and owning the descriptors that `recvmsg` returns.
//!   (Control messages are built and parsed in safe code.)
//! - `runtime`: registering a descriptor with tokio.
//! - `mapping::region`: owning a range of addresses, and atomic words over it.
//! - `mapping::read_only`: slices over sealed files, and copies from pooled ones.
//! - `prefetch`: hints for the processor.
//! - `mapping::scratch`: slices over private memory.
//! - `memfd::loan`: slices over a memfd that no other process has.
//! - `memfd::segment`: slots, whose exclusive use the caller promises.
//! - `reusable`: writing a value that nobody has borrowed.
//! - `slots`: keeping that promise by ownership.
#![deny(clippy::disallowed_types)]

#[cfg(not(target_os = "linux"))]
compile_error!("sm2-io is written for Linux: it needs memfd seals, epoll and SOCK_SEQPACKET");

pub mod clock;
mod cmsg;
pub mod counters;
mod datagram;
mod descriptors;
pub mod domain_socket;
pub mod epoll;
#[cfg(feature = "fault-injection")]
pub mod fault;
mod huge;
pub mod latch;

mod listener;
mod log_level;
pub mod mapping;
pub mod memfd;
mod prefetch;
mod process;
#[cfg(feature = "quic")]
pub mod quic;
pub mod reusable;
pub mod ring;
#[cfg(feature = "tokio")]
mod runtime;
mod shortage;
pub mod slots;
pub mod socket;
mod sync;
mod syscall;
mod thread;
pub mod timer;
pub mod waker;

pub use counters::{CounterEntry, CounterPage, CounterView};
pub use descriptors::{free_descriptors, raise_descriptor_limit};
pub use domain_socket::{
    BindOptions, DomainLock, DomainSocket, DomainSocketError, NotReclaimed, UnlockedSocket,
    socket_path,
};
pub use epoll::{Epoll, Event, Events, Interest, poll_now, wait_readable};
pub use latch::Latch;
pub use log_level::{WrongLogLevel, log_levels};
pub use mapping::{PooledMapping, Scratch, SealedMapping};
pub use memfd::{InspectedFd, Preallocated, SealedLoan, Segment, VerifyError};
pub use process::{Maker, PeerProcess, ProcessFd, is_signal_ignored};
pub use reusable::{InUse, Reusable};
pub use ring::Ring;
#[cfg(feature = "tokio")]
pub use runtime::watch_readable;
pub use shortage::is_shortage;
pub use slots::{SegmentFd, Slot, UnusedSegment};
pub use socket::{
    Listener, PeerCredentials, Received, ReceivedFds, RecvError, SendError, SeqPacket,
};
pub use syscall::files::{duplicate, lock_file};
pub use thread::{run_when_idle, spawn_without_signals};
pub use timer::Timer;
pub use waker::Waker;
