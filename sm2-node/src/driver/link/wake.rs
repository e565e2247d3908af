//! Waking the other side of a link, and asking to be woken.

use std::io::IoSlice;
use std::sync::Arc;

use sm2_io::{Interest, Ring, SendError, is_shortage};
use sm2_proto::link::{At, Wake, doorbell};

use super::LinkDriver;
use crate::driver::event_sets::LinkSets;

impl LinkDriver {
    /// Whether each message makes the link's socket readable.
    pub(crate) const fn is_woken_by_socket(&self) -> bool {
        self.machine.is_woken_by_socket()
    }

    /// The ring and its word that the next message fills, if this link receives through a ring.
    pub(in crate::driver) fn next_word(&self) -> Option<(Arc<Ring>, At)> {
        let word = self.machine.next_word()?;
        Some((Arc::clone(self.mapped.incoming.as_ref()?), word))
    }

    /// Announces that a thread is about to sleep until this link has an event.
    //= SM2-RNG-012
    pub(in crate::driver) fn park(&self) {
        if self.machine.end().is_none() {
            self.machine.park(&self.mapped);
        }
    }

    /// Wakes the other side if that is needed. If the socket is full, it is readable at the other
    /// end, so the other side is awake or will wake.
    //= SM2-RNG-012
    #[inline]
    pub(in crate::driver) fn wake(&mut self, wake: Wake, sets: &LinkSets) {
        if wake.is_needed() {
            self.ring_bell(sets);
        }
    }

    /// Sends a DOORBELL. Without memory for it, sends it when the socket is writable: the other side sleeps, and
    /// nothing else wakes it.
    //= SM2-TRN-013
    pub(super) fn ring_bell(&mut self, sets: &LinkSets) {
        let Some(socket) = &self.socket else { return };
        if let Err(SendError::Io(error)) = socket.send(&[IoSlice::new(&doorbell())], &[])
            && is_shortage(&error)
        {
            self.be_short_of_memory();
            self.bell_due = true;
            self.watch(Interest::BOTH, sets);
        }
    }
}
