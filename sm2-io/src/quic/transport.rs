//! What both sides say of themselves when a connection begins, and how it is sent.

use std::{sync::Arc, time::Duration};

use quinn_proto::{
    IdleTimeout, TransportConfig, VarInt,
    congestion::{BbrConfig, ControllerFactory, CubicConfig, NewRenoConfig},
};
use sm2_proto::limits::MESSAGES_IN_THE_MAKING_MAX;

use super::{congestion::SteadyConfig, observed::ObservedConfig};

/// The name of what is spoken (RFC 7301).
//= SM2-GWC-002
pub const ALPN: &[u8] = b"sm2-gateway/1";
/// A connection on which nothing came for so long is lost.
//= SM2-GWC-003
pub const IDLE: Duration = Duration::from_secs(5);
/// Something is sent as often.
//= SM2-GWC-003
pub const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// How many calls of a peer have no reply yet.
//= SM2-GWS-004
pub const CALLS_MAX: u32 = 256;
/// What may come on one stream before it is read.
const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// What may come on all streams of a connection before it is read.
const WINDOW_BYTES: u32 = 32 << 20;

/// How fast a connection sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Congestion {
    /// By the rate at which bytes arrive, with a short queue: loss alone does not slow it down.
    #[default]
    Steady,
    /// The same with longer queues (quinn-proto's, which is experimental).
    Bbr,
    /// By loss (RFC 9438).
    Cubic,
    /// By loss (RFC 9002).
    NewReno,
}

//= SM2-GWC-003, SM2-GWS-004
pub(super) fn config(congestion: Congestion) -> Arc<TransportConfig> {
    let mut config = TransportConfig::default();
    let messages = u32::try_from(MESSAGES_IN_THE_MAKING_MAX).unwrap_or(u32::MAX);
    config
        .max_idle_timeout(IdleTimeout::try_from(IDLE).ok())
        .keep_alive_interval(Some(KEEP_ALIVE))
        // One is the control stream.
        .max_concurrent_bidi_streams(VarInt::from_u32(CALLS_MAX + 1))
        .max_concurrent_uni_streams(VarInt::from_u32(messages))
        .stream_receive_window(VarInt::from_u32(STREAM_WINDOW_BYTES))
        .receive_window(VarInt::from_u32(WINDOW_BYTES))
        // How much it is given at a time is decided by who gives it.
        .send_window(WINDOW_BYTES.into())
        // By priorities alone: without it a stream that has begun keeps those before it waiting.
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
