//! QUIC between gateways (SPEC section 14.1): who is who, what is agreed on, and the UDP socket.
//!
//! The protocol itself is [`quinn_proto`], which does no I/O and reads no clock. What a gateway
//! says by it is decided by the machines of [`sm2_proto::gateway`]; the driver that feeds both is
//! in `sm2-gateway`.

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
    observed::idle_acks,
    socket::{Batch, Socket},
    tls::Trusted,
    transport::{ALPN, CALLS_MAX, Congestion, IDLE, KEEP_ALIVE},
};
