//! Waiting for replies that may come through a ring.

use super::super::Inner;
use crate::driver::token::LinkToken;
use crate::handle::Handle;

impl Inner {
    /// Drives the node before it looks for a reply. On the ring lane, drives it only if the last
    /// drive was some time ago.
    pub(crate) fn drive_for_reply(&mut self, handle: &Handle, token: LinkToken) {
        let link = self
            .interfaces
            .get(&handle.id)
            .and_then(|it| it.link(token));
        let is_call_free = link.is_some_and(|it| !it.is_woken_by_socket());
        let epoll = &handle.shared.epoll;
        if !self.drive_if_due(sm2_io::clock::now(), epoll) && !is_call_free {
            self.drive(epoll);
        }
    }
}
