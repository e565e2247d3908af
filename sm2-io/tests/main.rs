//! The integration tests of sockets, memory and descriptors.
//!
//! One program: its tests share one build and one link.

mod common;

mod aligned;
mod busy;
mod counters;
mod descriptors;
mod domain_socket;
mod domain_socket_path;
mod epoll;
mod foreign_memory;
mod hand_over;
mod hand_over_killed;
mod holes;
mod huge;
mod in_flight;
mod killed;
mod lock;
mod memfd;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod no_huge_pages;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod old_kernel;
mod pinned;
mod process;
#[cfg(feature = "quic")]
mod quic_link;
#[cfg(feature = "quic")]
mod quic_socket;
mod ring;
mod scratch;
mod seam;
mod signals;
mod socket;
mod timer;
