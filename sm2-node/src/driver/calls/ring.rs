//! Waiting for replies that may come by a ring.

use super::super::Inner;
use crate::driver::token::LinkToken;
use crate::handle::Handle;

impl Inner {
    /// Looks at the sockets before a reply; on the ring lane only if that was not done for a while.
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
