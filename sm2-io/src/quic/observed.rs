//! A congestion controller that counts app-limited acknowledgements.
//!
//! quinn-proto does not report how much of the data that it was given is still unsent. It does tell its
//! controller, with each batch of acknowledgements, that the connection is app-limited: all data was sent.

use std::{any::Any, sync::Arc, time::Instant};

use quinn_proto::{
    Connection, RttEstimator,
    congestion::{Controller, ControllerFactory, ControllerMetrics},
};

/// Makes the controllers of `F`, and observes them.
pub(super) struct ObservedConfig<F>(pub(super) Arc<F>);

impl<F: ControllerFactory + Send + Sync + 'static> ControllerFactory for ObservedConfig<F> {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(Observed {
            controller: Arc::clone(&self.0).build(now, current_mtu),
            app_limited_acks: 0,
        })
    }
}

/// An observed controller.
struct Observed {
    controller: Box<dyn Controller>,
    app_limited_acks: u64,
}

/// The number of batches of acknowledgements that arrived while the connection had no unsent data.
#[must_use]
pub fn app_limited_acks(connection: &Connection) -> u64 {
    let controller = connection.congestion_state().clone_box().into_any();
    controller
        .downcast::<Observed>()
        .map_or(0, |it| it.app_limited_acks)
}

impl Controller for Observed {
    fn on_sent(&mut self, now: Instant, bytes: u64, last_packet_number: u64) {
        self.controller.on_sent(now, bytes, last_packet_number);
    }

    fn on_ack(
        &mut self,
        now: Instant,
        sent: Instant,
        bytes: u64,
        app_limited: bool,
        rtt: &RttEstimator,
    ) {
        self.controller.on_ack(now, sent, bytes, app_limited, rtt);
    }

    fn on_end_acks(
        &mut self,
        now: Instant,
        in_flight: u64,
        app_limited: bool,
        largest_packet_num_acked: Option<u64>,
    ) {
        self.app_limited_acks += u64::from(app_limited);
        (self.controller).on_end_acks(now, in_flight, app_limited, largest_packet_num_acked);
    }

    fn on_congestion_event(
        &mut self,
        now: Instant,
        sent: Instant,
        is_persistent_congestion: bool,
        lost_bytes: u64,
    ) {
        (self.controller).on_congestion_event(now, sent, is_persistent_congestion, lost_bytes);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.controller.on_mtu_update(new_mtu);
    }

    fn window(&self) -> u64 {
        self.controller.window()
    }

    fn metrics(&self) -> ControllerMetrics {
        self.controller.metrics()
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Self {
            controller: self.controller.clone_box(),
            app_limited_acks: self.app_limited_acks,
        })
    }

    fn initial_window(&self) -> u64 {
        self.controller.initial_window()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
