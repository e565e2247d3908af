//! Waking the other side of a link, and asking to be woken.

use std::io::IoSlice;

use sm2_proto::link::{Wake, doorbell};

use super::LinkDriver;

impl LinkDriver {
    /// Whether each message makes the link's socket readable.
    pub(crate) const fn is_woken_by_socket(&self) -> bool {
        self.machine.is_woken_by_socket()
    }

    /// Announces that a thread is about to sleep until this link has an event.
    //= SM2-RNG-009
    pub(in crate::driver) fn park(&self) {
        if self.machine.end().is_none() {
            self.machine.park(&self.mapped);
        }
    }

    /// Wakes the other side if that is needed. If the socket is full, it is readable at the other
    /// end, so the other side is awake or will wake.
    //= SM2-RNG-009
    #[inline]
    pub(in crate::driver) fn wake(&self, wake: Wake) {
        if wake.is_needed()
            && let Some(socket) = &self.socket
        {
            let _ = socket.send(&[IoSlice::new(&doorbell())], &[]);
        }
    }
}
