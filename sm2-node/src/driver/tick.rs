//! Ticking the interfaces that have deadlines, for the control side.

use std::sync::Arc;

use sm2_proto::{Instant, InterfaceId};

use super::control::Control;
use super::event_sets::NodeSets;

impl Control {
    /// An interface has to be ticked at this time.
    //= SM2-QOS-009
    pub(super) fn tick_at(&mut self, interface: InterfaceId, at: Instant) {
        self.qos_timer.interfaces.insert(interface);
        self.qos_timer.set(at);
    }

    /// Ticks all interfaces that have deadlines.
    //= SM2-QOS-009
    pub(super) fn on_qos_timer(&mut self, sets: &NodeSets) {
        if !self.qos_timer.fires() {
            return;
        }
        let now = sm2_io::clock::now();
        let all: Vec<_> = self.qos_timer.interfaces.iter().copied().collect();
        for id in all {
            let Some(interface) = self.interfaces.get(&id).map(Arc::clone) else {
                self.qos_timer.interfaces.remove(&id);
                continue;
            };
            if let Some(results) = interface.tick(now) {
                self.handle(id, results, sets);
            }
        }
    }
}
