//! The road of a short message from the program's bytes to the rings of all links, under one lock:
//!
//! 1. [`DeclaredInterface::publish_to_rings`] checks that each open link is on the road.
//! 2. Each link's machine writes a message of at most 104 bytes into a cell of the ring (`link/road.rs`).
//! 3. For a longer one, and if a link does not take it in a cell, the outbox leases a slot; payload and head are copied
//!    into it once, for all links, and each machine puts its word into the ring.
//! 4. The counters of the publisher follow, after the words, since receivers need not wait for them.
//!
//! A message leaves the road at one place: where a publication would have to read a socket, to wait, or to prepare
//! another form of the message, it takes the general way in `publish.rs`. A single link that is suspended, owes, or
//! does not accept the message gets what [`Offered::offer`] does for it, and the other links stay on the road.

use sm2_proto::Instant;
use sm2_proto::limits::CELL_MAX;
use sm2_proto::link::{CellMessage, RingMessage, Status};

use super::DeclaredInterface;
use super::publish::Offered;
use super::service::CallBody;
use super::{CallId, Choice};
use crate::driver::context::Context;
use crate::driver::outbox::{Forms, Label, Needs, info};
use crate::driver::token::LinkToken;
use crate::outgoing::{COPY_UNDER_LOCK_MAX, Outgoing};
use crate::pool::Lease;
use crate::published::Published;

/// How a short message travels to all links.
#[derive(Clone, Copy, Debug)]
enum Road {
    /// In the cells of their rings.
    Cells,
    /// In one slot, which a word in each ring names.
    Slot,
    /// It has to be published in the general way.
    Closed,
}

impl DeclaredInterface {
    /// Publishes short messages in order, while the road is open. Returns how many messages it has published,
    /// and adds their results to `sum`.
    #[inline]
    pub(crate) fn publish_to_rings(
        &mut self,
        messages: &[Outgoing<'_>],
        time: Instant,
        context: &mut Context<'_>,
        sum: &mut Published,
    ) -> usize {
        if self.waiting > 0 {
            return 0;
        }
        let mut count = 0;
        for message in messages {
            let Outgoing::Encoded(bytes) = message else {
                break;
            };
            if bytes.len() > COPY_UNDER_LOCK_MAX {
                break;
            }
            let published = match self.open_road(bytes.len(), context) {
                Road::Cells => self.publish_in_cells(bytes, time, context),
                Road::Slot => match self.publish_on_road(bytes, time, context) {
                    Some(published) => published,
                    None => break,
                },
                Road::Closed => break,
            };
            sum.add(published);
            count += 1;
        }
        count
    }

    /// How a message travels. If a link delays it, settles the messages that came back, and looks again.
    #[inline]
    fn open_road(&mut self, len: usize, context: &mut Context<'_>) -> Road {
        let road = self.road(len);
        if matches!(road, Road::Closed) && !self.has_room() {
            self.harvest(context);
            return self.road(len);
        }
        road
    }

    /// How a message travels. The road is open if links are open, all of them have rings, and none delays a
    /// publication. If a link is opening, the other side may already count as linked, so the caller reads the sockets
    /// first.
    #[inline]
    fn road(&self, len: usize) -> Road {
        // A latched message is stored.
        let mut in_cells = len <= CELL_MAX && !self.latched.is_used();
        let mut is_any_open = false;
        for link in self.links.iter() {
            if link.is_on_road(len as u64) {
                is_any_open = true;
                in_cells = in_cells && link.takes_cells();
            } else if link.is_beside_road() {
                is_any_open = true;
                in_cells = false;
            } else if link.end().is_none() {
                return Road::Closed;
            }
        }
        match (is_any_open, in_cells) {
            (true, true) => Road::Cells,
            (true, false) => Road::Slot,
            (false, _) => Road::Closed,
        }
    }

    /// Sends a message in the cells of all open links.
    #[inline]
    fn publish_in_cells(
        &mut self,
        bytes: &[u8],
        time: Instant,
        context: &mut Context<'_>,
    ) -> Published {
        self.published += 1;
        let id = self.published;
        let message = CellMessage {
            id,
            time,
            status: Status::Ok,
            bytes,
        };
        let (mut links, mut has_ended) = (0, false);
        for link in self.links.iter_mut() {
            if link.is_open() {
                link.send_in_cell(&message, context, &mut self.outbox);
                links += usize::from(link.end().is_none());
            }
            has_ended |= link.is_over_unnoticed();
        }
        self.count_publication(time, bytes.len() as u64, true, context);
        self.free_idle(time, context);
        if has_ended {
            self.notice_ends(context);
        }
        self.reports.report_drops(&mut self.links);
        Published {
            links,
            ..Published::default()
        }
    }

    /// Copies a message to a slot and sends it on all open links; `None` if there is no slot, or if a publication waits
    /// now.
    #[inline]
    fn publish_on_road(
        &mut self,
        bytes: &[u8],
        time: Instant,
        context: &mut Context<'_>,
    ) -> Option<Published> {
        let len = bytes.len() as u64;
        let mut lease = match self.outbox.lease_free(len) {
            Some(lease) => lease,
            None => self.lease_after_harvest(len, context)?,
        };
        lease.memory.bytes_mut(bytes.len()).copy_from_slice(bytes);
        self.published += 1;
        let (segment, slot, id) = (info(&lease), lease.slot, self.published);
        let key = self.outbox.store_in_slot(lease, Label { id, time, len });
        self.latched.push(key, &mut self.outbox);
        let message = RingMessage {
            key: key.to_raw(),
            id,
            len,
            segment,
            slot,
        };
        let mut offered = Offered::default();
        for link in self.links.iter_mut() {
            if link.is_on_road(len) {
                link.send_on_road(&message, time, context, &mut self.outbox);
                offered.links += usize::from(link.end().is_none());
            } else if link.is_open() {
                offered.offer(key, len, link, context, &mut self.outbox);
            }
            offered.has_ended |= link.is_over_unnoticed();
        }
        debug_assert!(offered.waiting.is_empty(), "the road was not open");
        self.outbox.release(key);
        self.count_publication(time, len, true, context);
        self.free_idle(time, context);
        if offered.has_ended {
            self.notice_ends(context);
        }
        self.reports.report_drops(&mut self.links);
        Some(offered.published())
    }

    /// Makes a call with a short request, under one lock. `None` if the call has to be made in the general way: it
    /// waits for a server, its server has no ring, or no slot is free before messages that came back are settled.
    pub(crate) fn call_on_road(
        &mut self,
        request: &Outgoing<'_>,
        deadline: Option<Instant>,
        context: &mut Context<'_>,
    ) -> Option<CallId> {
        let len = request.len() as u64;
        let Choice::Link { token, needs } = self.calls.choose_server(len, &self.links) else {
            return None;
        };
        let body = self.short_body(request, token, needs)?;
        Some(self.call(token, body, len, deadline, context))
    }

    /// Sends a short reply, under one lock. `None`, and nothing is sent, if it has to be sent in the general way, as
    /// for [`call_on_road`](Self::call_on_road); also if the client is gone, or does not accept the reply.
    pub(crate) fn reply_on_road(
        &mut self,
        call: CallId,
        reply: &Outgoing<'_>,
        status: Status,
        context: &mut Context<'_>,
    ) -> Option<()> {
        let len = reply.len() as u64;
        let link = self.links.get(call.token);
        let link = link.filter(|link| link.is_open() && link.accepts(len))?;
        let body = self.short_body(reply, call.token, link.needs())?;
        self.reply(call, body, len, status, context).then_some(())
    }

    /// A short message for a cell of this link, or else in a slot that is free now.
    fn short_body<'a>(
        &mut self,
        message: &'a Outgoing<'_>,
        token: LinkToken,
        needs: Needs,
    ) -> Option<CallBody<'a>> {
        let Outgoing::Encoded(bytes) = message else {
            return None;
        };
        if self.takes_in_cell(token, bytes.len()) {
            return Some(CallBody::Cell(bytes));
        }
        if bytes.len() > COPY_UNDER_LOCK_MAX || !needs.slot {
            return None;
        }
        let mut lease = self.outbox.lease_free(bytes.len() as u64)?;
        lease.memory.bytes_mut(bytes.len()).copy_from_slice(bytes);
        Some(CallBody::Stored(Forms::in_slot(lease)))
    }

    /// Leases a slot after the messages that came back were settled; `None` if there is none, or if a publication waits
    /// now.
    #[cold]
    fn lease_after_harvest(
        &mut self,
        len: u64,
        context: &mut Context<'_>,
    ) -> Option<Lease<sm2_io::Slot>> {
        self.harvest(context);
        self.suspend_holders(len);
        // A link has ended, or is suspended now.
        if matches!(self.road(len as usize), Road::Closed) {
            return None;
        }
        self.outbox.lease(len).ok()
    }
}
