//! The requests and replies of a server.

use bytes::Bytes;
use sm2_proto::link::Status;

use super::DeclaredInterface;
use super::calls::CallId;
use super::taken::{Full, Taken};
use crate::driver::context::Context;
use crate::driver::outbox::{Forms, Label};

impl DeclaredInterface {
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
            let sequence = taken.header.sequence;
            *into = None;
            self.reply_bare(CallId { token, id }, status, context);
            self.give_back(token, sequence, context);
        }
        Ok(())
    }

    /// Whether the client no longer wants the reply, or is gone.
    pub(crate) fn is_cancelled(&self, call: CallId) -> bool {
        match self.link(call.token) {
            Some(link) => link.end().is_some() || link.calls.cancelled.contains(&call.id),
            None => true,
        }
    }

    /// Sends a reply without a payload.
    pub(crate) fn reply_bare(&mut self, call: CallId, status: Status, context: &mut Context<'_>) {
        let forms = Forms {
            inline: Some(Bytes::new()),
            ..Forms::default()
        };
        self.reply(call, forms, 0, status, context);
    }

    /// Sends a reply that says that the call failed.
    pub(crate) fn reply_failed(&mut self, call: CallId, reason: Bytes, context: &mut Context<'_>) {
        let len = reason.len() as u64;
        let forms = Forms {
            inline: Some(reason),
            ..Forms::default()
        };
        self.reply(call, forms, len, Status::Failed, context);
    }

    /// Sends a reply, at the time when the call of the program began. Returns whether the client's link was still
    /// open.
    pub(crate) fn reply(
        &mut self,
        call: CallId,
        forms: Forms,
        len: u64,
        status: Status,
        context: &mut Context<'_>,
    ) -> bool {
        let label = Label {
            id: call.id,
            time: context.now,
            len,
        };
        let key = self.outbox.store(forms, label);
        let sent = self.with_sending_link(call.token, context, |link, outbox, context| {
            link.calls.cancelled.remove(&call.id);
            let open = link.is_open();
            if open {
                link.send(key, status, context, outbox);
            }
            open
        });
        self.outbox.release(key);
        sent == Some(true)
    }
}
