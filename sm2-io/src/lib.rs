//! SM2's adapters to the operating system: seqpacket sockets that carry
//! descriptors, sealed memory files, mappings, epoll, the claim on a domain's socket.
//!
//! Each adapter does one thing the kernel offers, and turns its answers into
//! types. There is no policy here and no protocol: what a datagram means, whether a
//! descriptor may be mapped, and what to do with a slow peer is decided by the
//! machines of [`sm2_proto`]. The drivers in `sm2-node` and `sm2-manager` are who
//! calls. Linux only.
//!
//! | module | what |
//! | --- | --- |
//! | [`socket`] | [`SeqPacket`], [`Listener`]: datagrams with descriptors |
//! | [`endpoint`] | [`socket_path`]: where a domain's socket is |
//! | [`claim`] | [`Claim`]: owning that place, alone |
//! | [`memfd`] | [`facts`](memfd::facts), [`SealedLoan`], [`Blank`], [`Segment`]: memory to share |
//! | [`slots`] | [`Slot`]: a segment's slots, each with one owner |
//! | [`mapping`] | [`Mapping`]: looking at shared memory |
//! | [`ring`] | [`Ring`]: words that two processes write |
//! | [`counters`] | [`CounterPage`], [`CounterView`]: what a node counts, for tools to look at |
//! | [`epoll`] | [`Epoll`], [`wait_readable`]: waiting |
//! | [`waker`] | [`Waker`]: waking a loop from another thread |
//! | [`timer`] | [`Timer`]: waking a loop at a moment |
//! | [`clock`] | [`now`](clock::now) |
//! | `quic` | QUIC between gateways (feature `quic`) |
//!
//! # Where `unsafe` lives
//!
//! All of it that SM2 has is in this crate. Every block says what makes it true.
//!
//! - `socket`, `listener`: `sendmsg`, `recvmsg`, `ioctl(SIOCOUTQ)`, and owning the descriptors that
//!   `recvmsg` and `accept4` return. (Control messages are built and parsed in
//!   safe code.)
//! - `epoll`: `epoll_pwait2`.
//! - `mapping`: `mmap`, `munmap`, `madvise`, `mlock`, prefetching, slices over read-only and private
//!   mappings, and atomic words over those that change.
//! - `loan`: slices over a memfd that nobody else has.
//! - `segment`: slots, whose exclusive use the caller promises.
//! - `slots`: keeping that promise by ownership.

#[cfg(not(target_os = "linux"))]
compile_error!("sm2-io is written for Linux: it needs memfd seals, epoll and SOCK_SEQPACKET");

pub mod claim;
pub mod clock;
mod control;
pub mod counters;
mod datagram;
pub mod endpoint;
pub mod epoll;
mod huge;
mod listener;
pub mod mapping;
pub mod memfd;
#[cfg(feature = "quic")]
pub mod quic;
pub mod ring;
#[cfg(feature = "tokio")]
mod runtime;
pub mod slots;
pub mod socket;
mod sync;
pub mod timer;
pub mod waker;

pub use claim::{Claim, DomainLock, Endpoint, HandOver, NotReclaimed};
pub use counters::{CounterEntry, CounterPage, CounterView};
pub use endpoint::{EndpointError, socket_path};
pub use epoll::{Epoll, Event, Events, Interest, wait_readable};
pub use mapping::{PooledMapping, Scratch, SealedMapping};
pub use memfd::{Blank, InspectedFd, SealedLoan, Segment, VerifyError};
pub use ring::Ring;
#[cfg(feature = "tokio")]
pub use runtime::watch_readable;
pub use slots::{SegmentFd, Slot};
pub use socket::{
    Listener, PeerCredentials, Received, ReceivedFds, RecvError, SendError, SeqPacket,
};
pub use timer::Timer;
pub use waker::Waker;
