//! The peers: one module for each, which implements the traits of [`contract`].
//!
//! To add one: a module with a type that implements [`Peer`], a line in [`Family`], in
//! [`with_peer!`](crate::with_peer) and its lines in [`catalogue`].

#[cfg(feature = "aeron")]
pub mod aeron;
pub mod catalogue;
pub mod contract;
pub mod dds;
#[cfg(feature = "iceoryx2")]
pub mod iceoryx2;
pub mod mcap_file;
pub mod python;
pub mod quinn;
pub mod raw;
pub mod sm2;
#[cfg(feature = "zenoh")]
pub mod zenoh;

pub use catalogue::{Family, PEERS, Part, PeerInfo, Reach};
pub use contract::{Call, Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS};

/// Evaluates an expression with `P` as the type of the domain's peer: `with_peer!(&domain, P => …)`.
#[macro_export]
macro_rules! with_peer {
    ($domain:expr, $peer:ident => $body:expr) => {
        match $crate::peers::catalogue::family(&$domain.peer) {
            // Processes in Python are programs of their own: only the daemon of one is a process of this program.
            Some($crate::peers::Family::Sm2 | $crate::peers::Family::Python) => {
                type $peer = $crate::peers::sm2::Sm2;
                $body
            }
            Some($crate::peers::Family::Raw) => {
                type $peer = $crate::peers::raw::Raw;
                $body
            }
            #[cfg(feature = "iceoryx2")]
            Some($crate::peers::Family::Iceoryx2) => {
                type $peer = $crate::peers::iceoryx2::Iceoryx2;
                $body
            }
            #[cfg(feature = "aeron")]
            Some($crate::peers::Family::Aeron) => {
                type $peer = $crate::peers::aeron::Aeron;
                $body
            }
            #[cfg(feature = "zenoh")]
            Some($crate::peers::Family::Zenoh) => {
                type $peer = $crate::peers::zenoh::Zenoh;
                $body
            }
            Some($crate::peers::Family::Dds) => {
                type $peer = $crate::peers::dds::Dds;
                $body
            }
            Some($crate::peers::Family::Quinn) => {
                type $peer = $crate::peers::quinn::Quinn;
                $body
            }
            _ => Err($crate::peers::PeerError::new(
                "find the peer",
                "it is unknown, or was left out of this build",
            )
            .into()),
        }
    };
}
