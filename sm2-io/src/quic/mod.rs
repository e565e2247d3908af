//! QUIC between gateways (SPEC section 14.1): keys, TLS, transport parameters and the UDP socket.
//!
//! [`quinn_proto`] implements the protocol; it does no I/O and reads no clock. The machines of
//! [`sm2_proto::gateway`] decide what a gateway sends, and the driver in `sm2-gateway` feeds both.

mod congestion;
mod endpoint;
mod key;
mod observed;
mod socket;
mod tls;
mod transport;

pub use self::{
    congestion::SteadyConfig,
    endpoint::{Arrival, Endpoint, peer_of},
    key::{KeyError, SecretKey},
    observed::app_limited_acks,
    socket::{Batch, Socket},
    tls::Trusted,
    transport::{ALPN, CALLS_MAX, Congestion, IDLE, KEEP_ALIVE},
};
/// An error of TLS, as [`Endpoint::new`] returns it.
pub use rustls::Error as TlsError;
