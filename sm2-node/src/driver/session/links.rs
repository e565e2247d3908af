//! States how many ends of links this node can have, and keeps that true.

use std::time::Duration;

use sm2_proto::node::Input;

use crate::driver::control::Control;

/// The pause after which a node without room looks again: the program may have closed other descriptors.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

impl Control {
    /// Tells the Manager how many links this node can have, if that has grown. A node that has no room looks
    /// again when its timer says so. The caller drains the machine.
    //= SM2-LNK-007
    pub(in crate::driver) fn state_links(&mut self) {
        if let Some(max_links) = self.link_room.look(sm2_io::free_descriptors) {
            self.session.tell(Input::MaxLinks(max_links));
        }
        self.look_again();
    }

    /// Tells the Manager that this node has no room beyond the links that it has, because a descriptor of a
    /// link was lost.
    //= SM2-LNK-007, SM2-TRN-011
    pub(super) fn ran_out_of_links(&mut self) {
        if let Some(max_links) = self.link_room.run_out() {
            self.session.tell(Input::MaxLinks(max_links));
        }
        self.look_again();
    }

    /// Sets the timer if this node has no room. Without a connection, the timer is for the next attempt to
    /// connect.
    fn look_again(&mut self) {
        if self.session.is_connected() && self.link_room.is_short() {
            let at = sm2_io::clock::now().after(LOOK_AGAIN);
            if let Err(error) = self.reconnect.timer.set(Some(at)) {
                tracing::error!(%error, "cannot set the timer: this node may get no more links");
            }
        }
    }
}
