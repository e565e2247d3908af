//! The calls of a client, and the requests and replies of a server.

use bytes::Bytes;
use sm2_proto::Instant;
use sm2_proto::limits::CELL_MAX;
use sm2_proto::link::{CellMessage, Input, Status};

use super::DeclaredInterface;
use super::calls::{CallId, Choice, Outcome};
use super::taken::{Full, Taken};
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{Forms, Label};
use crate::driver::token::LinkToken;

/// The payload of a request or a reply.
#[derive(Debug)]
pub(crate) enum CallBody<'a> {
    /// It is stored until its link has settled it.
    Stored(Forms),
    /// It is written to a cell of the link, which [takes](LinkDriver::takes_cells) cells.
    Cell(&'a [u8]),
}

impl DeclaredInterface {
    /// Chooses the server for the next call, with a request of this length. While a link to the first server is
    /// announced and has not come, also has the Manager asked for a PAGE, which ends
    /// [`is_opening`](super::links::Links::is_opening): the link may never come.
    pub(crate) fn wait_for_server(&mut self, len: u64) -> Choice {
        let choice = self.calls.choose_server(len, &self.links);
        if choice == Choice::Opening && self.links.due > 0 {
            self.for_control.wants_page = true;
        }
        choice
    }

    /// Makes a call on this link, at the time when the call of the program began.
    pub(crate) fn call(
        &mut self,
        token: LinkToken,
        body: CallBody<'_>,
        len: u64,
        deadline: Option<Instant>,
        context: &mut Context<'_>,
    ) -> CallId {
        let id = self.links.get(token).map_or(0, |link| link.calls.last) + 1;
        let call = CallId { token, id };
        self.calls.begin(call);
        // Zero means no deadline.
        let time = deadline.unwrap_or_default();
        let sent = self.send(call, body, (time, len), Status::Ok, context, |link| {
            link.calls.last = id;
            true
        });
        (self.reports).count_publication(context.now, len, true);
        // If the link ended before the machine accepted the call, no output reports the call.
        let link = self.links.get(token);
        let over = link.is_none_or(|link| link.end().is_some());
        if !sent || over {
            self.calls.finish(call, Outcome::ServerGone);
        }
        call
    }

    /// Returns the outcome of a call once the call is over, and removes the call.
    pub(crate) fn outcome(&mut self, call: CallId, context: &mut Context<'_>) -> Option<Outcome> {
        self.collect_replies(call.token, context);
        self.calls.take(call)
    }

    /// Whether a call is over, and the program has not seen its outcome.
    pub(super) fn is_call_over(&mut self, call: CallId, context: &mut Context<'_>) -> bool {
        self.collect_replies(call.token, context);
        self.calls.is_over(call)
    }

    fn collect_replies(&mut self, token: LinkToken, context: &mut Context<'_>) {
        let Some(link) = self.links.get_mut(token).filter(|it| it.may_take()) else {
            return;
        };
        (self.calls).collect(token, link, context, &mut self.outbox);
        if !link.is_settled() {
            self.settle_link(token, context);
        }
    }

    /// Called when the program no longer wants the reply.
    pub(crate) fn cancel(&mut self, call: CallId, context: &mut Context<'_>) {
        let CallId { token, id } = call;
        if self.calls.is_pending(call) {
            self.with_link(token, context, |link, outbox, context| {
                link.feed(Input::Cancel { call: id }, context.sets, outbox);
            });
        }
    }

    /// Removes a call that no thread waits for any more. Gives its reply back if the reply has
    /// come, or when it comes.
    pub(crate) fn forget(&mut self, call: CallId, context: &mut Context<'_>) {
        self.cancel(call, context);
        if let Some(Outcome::Reply(taken)) = self.calls.remove(call)
            && let Some((token, sequence)) = taken.place()
        {
            self.give_back(token, sequence, context);
        }
    }

    /// Takes the next request that is neither cancelled nor late. Answers cancelled and late
    /// requests with a reply that has no payload.
    pub(crate) fn take_request(
        &mut self,
        into: &mut Option<Taken>,
        context: &mut Context<'_>,
    ) -> Result<(), Full> {
        while self.take(&mut |taken| *into = Some(taken), context)?
            && let Some(taken) = into
        {
            let (token, id) = (taken.origin.token, taken.header.id);
            let deadline = taken.header.time;
            let cancelled = self.is_cancelled(CallId { token, id });
            let late = deadline.0 != 0 && deadline <= sm2_io::clock::now();
            //= SM2-SRV-002
            let status = match (cancelled, late) {
                (true, _) => Status::Cancelled,
                (false, true) => Status::DeadlinePassed,
                (false, false) => {
                    let link = self.links.get_mut(token);
                    (self.reports).count_request(link, context.now, taken.header.len);
                    return Ok(());
                }
            };
            let place = taken.place();
            *into = None;
            self.reply_inline(CallId { token, id }, Bytes::new(), status, context);
            if let Some((token, sequence)) = place {
                self.give_back(token, sequence, context);
            }
        }
        Ok(())
    }

    /// Whether the client no longer wants the reply, or is gone.
    pub(crate) fn is_cancelled(&self, call: CallId) -> bool {
        match self.links.get(call.token) {
            Some(link) => link.end().is_some() || link.calls.cancelled.contains(&call.id),
            None => true,
        }
    }

    /// Sends a reply that is as short as the reason of a failure. If it fits into a cell, it needs no memory, which may
    /// be what is short.
    pub(crate) fn reply_inline(
        &mut self,
        call: CallId,
        payload: Bytes,
        status: Status,
        context: &mut Context<'_>,
    ) {
        let len = payload.len() as u64;
        let body = match self.takes_in_cell(call.token, payload.len()) {
            true => CallBody::Cell(&payload),
            false => CallBody::Stored(Forms::inline(payload)),
        };
        self.reply(call, body, len, status, context);
    }

    /// Whether this link takes a request or a reply of this length in a cell now.
    pub(super) fn takes_in_cell(&self, token: LinkToken, len: usize) -> bool {
        len <= CELL_MAX && self.links.get(token).is_some_and(LinkDriver::takes_cells)
    }

    /// Sends a reply, at the time when the call of the program began. Returns whether the client's link was still
    /// open.
    pub(crate) fn reply(
        &mut self,
        call: CallId,
        body: CallBody<'_>,
        len: u64,
        status: Status,
        context: &mut Context<'_>,
    ) -> bool {
        self.send(call, body, (context.now, len), status, context, |link| {
            link.calls.cancelled.remove(&call.id);
            link.is_open()
        })
    }

    /// Sends a request or a reply on the link of its call, if `is_wanted` there, and does the work that can follow from
    /// that. On the ring lane, this is usually none. Returns whether the message was wanted.
    fn send(
        &mut self,
        call: CallId,
        body: CallBody<'_>,
        (time, len): (Instant, u64),
        status: Status,
        context: &mut Context<'_>,
        is_wanted: impl FnOnce(&mut LinkDriver) -> bool,
    ) -> bool {
        let id = call.id;
        let (stored, bytes) = match body {
            CallBody::Stored(forms) => {
                let key = self.outbox.store(forms, Label { id, time, len });
                (Some(key), &[][..])
            }
            CallBody::Cell(bytes) => (None, bytes),
        };
        let in_cell = CellMessage {
            id,
            time,
            status,
            bytes,
        };
        let mut is_sent = false;
        if let Some(link) = self.links.get_mut(call.token) {
            is_sent = is_wanted(link);
            match stored {
                _ if !is_sent => {}
                Some(key) => link.send(key, status, context, &mut self.outbox),
                None => link.send_in_cell(&in_cell, context, &mut self.outbox),
            }
            match link.is_settled() {
                true => link.watch_in_background(context.sets),
                false => self.settle_link(call.token, context),
            }
        }
        if let Some(key) = stored {
            self.outbox.release(key);
        }
        is_sent
    }
}
