//! Metrics of a gateway for Prometheus: `GET /metrics` over HTTP, in the OpenMetrics text format.
//!
//! | metric | labels | |
//! | --- | --- | --- |
//! | `sm2_gateway_peer_connected` | `peer` | 1 or 0 for each trusted peer |
//! | `sm2_gateway_peer_rtt_seconds` | `peer` | round-trip time |
//! | `sm2_gateway_peer_denied` | `peer` | number of denied names |
//! | `sm2_gateway_peer_COUNT_total` | `peer` | messages, requests and replies in total |
//! | `sm2_gateway_COUNT_total` | `peer`, `kind`, `name` | the same for one topic or service |
//!
//! `COUNT` is each field of [`Counts`](crate::Counts). Counters belong to the
//! current connection and start at zero with the next one, as Prometheus expects of counters. Names
//! without counts are left out, so that no peer can fill a database by offering names.
//!
//! [`Server`] and [`encode`] serve the metrics of another program in the same way.
//!
//! There is no TLS and no authentication: every client can read the names of topics. Therefore
//! listen on a loopback address. The cost of slow or hostile scrapers is bounded: 8 connections at
//! a time with 5 s each, 10 reports of the hub per second, and one copy of the text in memory.

mod server;
mod text;
mod thread;

use tokio::net::TcpListener;

use crate::channel::hub::HubHandle;

pub use self::{
    server::Timeouts,
    text::{Value, ValueKind, encode},
    thread::Server,
};

/// Accepts connections until the hub task ends.
pub(crate) async fn serve(listener: TcpListener, hub: HubHandle, timeouts: Timeouts) {
    let source = hub.clone();
    let make = move || {
        let hub = source.clone();
        let text = async move { text::text(&hub.report().await.ok()?).ok() };
        Box::pin(text) as server::Made
    };
    tokio::select! {
        () = server::serve(listener, Box::new(make), timeouts) => {}
        () = hub.closed() => {}
    }
}
