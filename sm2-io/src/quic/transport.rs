//! The transport parameters, ALPN and congestion control of a connection.

use std::{sync::Arc, time::Duration};

use quinn_proto::{
    IdleTimeout, TransportConfig, VarInt,
    congestion::{BbrConfig, ControllerFactory, CubicConfig, NewRenoConfig},
};
use sm2_proto::limits::MESSAGES_IN_FLIGHT_MAX;

use super::{congestion::SteadyConfig, observed::ObservedConfig};

/// The application protocol (ALPN, RFC 7301).
//= SM2-GWC-002
pub const ALPN: &[u8] = b"sm2-gateway/1";
/// A connection that receives nothing for this time is lost.
//= SM2-GWC-003
pub const IDLE: Duration = Duration::from_secs(5);
/// An idle connection sends a packet after this time.
//= SM2-GWC-003
pub const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// The most calls of a peer without a reply.
//= SM2-GWS-004
pub const CALLS_MAX: u32 = 256;
/// Flow control: unread bytes on one stream.
const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// Flow control: unread bytes on all streams of a connection.
const WINDOW_BYTES: u32 = 32 << 20;

/// The congestion controller of a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Congestion {
    /// By delivery rate, with a short queue: random loss does not slow it down.
    #[default]
    Steady,
    /// BBR of quinn-proto, which is experimental: by delivery rate, with longer queues.
    Bbr,
    /// By loss (RFC 9438).
    Cubic,
    /// By loss (RFC 9002).
    NewReno,
}

//= SM2-GWC-003, SM2-GWS-004
pub(super) fn config(congestion: Congestion) -> Arc<TransportConfig> {
    let mut config = TransportConfig::default();
    let messages = u32::try_from(MESSAGES_IN_FLIGHT_MAX).unwrap_or(u32::MAX);
    config
        .max_idle_timeout(IdleTimeout::try_from(IDLE).ok())
        .keep_alive_interval(Some(KEEP_ALIVE))
        // One is the control stream.
        .max_concurrent_bidi_streams(VarInt::from_u32(CALLS_MAX + 1))
        .max_concurrent_uni_streams(VarInt::from_u32(messages))
        .stream_receive_window(VarInt::from_u32(STREAM_WINDOW_BYTES))
        .receive_window(VarInt::from_u32(WINDOW_BYTES))
        // The writer (`sm2-gateway`) bounds the unsent data itself.
        .send_window(WINDOW_BYTES.into())
        // Without it, a stream that was started holds up streams of equal priority.
        .send_fairness(true);
    match congestion {
        Congestion::Steady => observe(&mut config, SteadyConfig),
        Congestion::Bbr => observe(&mut config, BbrConfig::default()),
        Congestion::Cubic => observe(&mut config, CubicConfig::default()),
        Congestion::NewReno => observe(&mut config, NewRenoConfig::default()),
    };
    Arc::new(config)
}

fn observe<F: ControllerFactory + Send + Sync + 'static>(config: &mut TransportConfig, factory: F) {
    let observed = ObservedConfig(Arc::new(factory));
    config.congestion_controller_factory(Arc::new(observed));
}
