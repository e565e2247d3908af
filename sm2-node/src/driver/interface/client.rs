//! The calls of a client.

use sm2_proto::Instant;
use sm2_proto::link::{Input, Status};

use super::DeclaredInterface;
use super::calls::{CallId, Outcome};
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{Forms, Label, Needs};
use crate::driver::token::LinkToken;

/// The server for the next call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Choice {
    /// The call goes to the server of this link, which needs these forms.
    Link { token: LinkToken, needs: Needs },
    /// A server exists, but no link to a server is open yet.
    Opening,
    /// There is no server.
    NoServer,
    /// No server accepts a request of this length; the greatest length that one accepts.
    TooLong { max_len: u64 },
    /// The program holds as many calls and replies of each server as it may.
    TooMany { limit: usize },
}

impl DeclaredInterface {
    /// Chooses the server for the next call, with a request of this length. While a link to the first server is
    /// announced and has not come, also has the Manager asked for a PAGE, which ends
    /// [`is_opening`](super::links::Links::is_opening): the link may never come.
    pub(crate) fn wait_for_server(&mut self, len: u64) -> Choice {
        let choice = self.choose_server(len);
        if choice == Choice::Opening && self.links.is_any_due() {
            self.for_control.wants_page = true;
        }
        choice
    }

    /// Chooses the server for the next call, with a request of this length.
    //= SM2-SRV-005, SM2-SRV-006
    pub(crate) fn choose_server(&self, len: u64) -> Choice {
        let is_meant =
            |link: &&LinkDriver| link.is_open() && (self.servers)(&link.origin.peer.name);
        let open = || self.links().filter(is_meant);
        // The choice and the limit use the same sum: otherwise a server whose replies are held would be
        // chosen and found full, while another one is free. Among links with equal sums, this is the oldest:
        // links are ordered by age.
        let load = |link: &LinkDriver| link.calls() + link.held();
        let accepting = open().filter(|link| link.accepts(len));
        let least = accepting.min_by_key(|link| load(link));
        match least {
            None => match open().map(LinkDriver::peer_max_len).max() {
                Some(max_len) => Choice::TooLong { max_len },
                None if self.links.is_opening() => Choice::Opening,
                None => Choice::NoServer,
            },
            Some(link) if load(link) >= link.max_borrowed() => Choice::TooMany {
                limit: link.max_borrowed(),
            },
            Some(link) => Choice::Link {
                token: link.token(),
                needs: link.needs(),
            },
        }
    }

    /// Makes a call on this link, at the time when the call of the program began.
    pub(crate) fn call(
        &mut self,
        token: LinkToken,
        forms: Forms,
        len: u64,
        deadline: Option<Instant>,
        context: &mut Context<'_>,
    ) -> CallId {
        let id = self.link(token).map_or(0, |link| link.calls.last) + 1;
        let call = CallId { token, id };
        self.calls.open.insert(call, None);
        let label = Label {
            id,
            // Zero means no deadline.
            time: deadline.unwrap_or_default(),
            len,
        };
        let key = self.outbox.store(forms, label);
        let sent = self.with_sending_link(token, context, |link, outbox, context| {
            link.calls.last = id;
            link.send(key, Status::Ok, context, outbox);
        });
        self.reports.count_call(context.now, len);
        self.outbox.release(key);
        // If the link ended before the machine accepted the call, no output reports the call.
        let over = self.link(token).is_none_or(|link| link.end().is_some());
        if sent.is_none() || over {
            self.calls.finish(call, Outcome::ServerGone);
        }
        call
    }

    /// Returns the outcome of a call once the call is over, and removes the call.
    pub(crate) fn outcome(&mut self, call: CallId, context: &mut Context<'_>) -> Option<Outcome> {
        self.collect_replies(call.token, context);
        let outcome = self.calls.open.get_mut(&call)?.take()?;
        self.calls.open.remove(&call);
        Some(outcome)
    }

    /// Whether a call is over, and the program has not seen its outcome.
    pub(super) fn is_call_over(&mut self, call: CallId, context: &mut Context<'_>) -> bool {
        self.collect_replies(call.token, context);
        self.calls.is_over(call)
    }

    fn collect_replies(&mut self, token: LinkToken, context: &mut Context<'_>) {
        if self.link(token).is_some_and(LinkDriver::may_take) {
            self.settle_link(token, context);
        }
    }

    /// Called when the program no longer wants the reply.
    pub(crate) fn cancel(&mut self, call: CallId, context: &mut Context<'_>) {
        let CallId { token, id } = call;
        if self.calls.open.get(&call).is_some_and(Option::is_none) {
            self.with_link(token, context, |link, outbox, context| {
                link.feed(Input::Cancel { call: id }, context.sets, outbox);
            });
        }
    }

    /// Removes a call that no thread waits for any more. Gives its reply back if the reply has
    /// come, or when it comes.
    pub(crate) fn forget(&mut self, call: CallId, context: &mut Context<'_>) {
        self.cancel(call, context);
        if let Some(Some(Outcome::Reply(taken))) = self.calls.open.remove(&call) {
            self.give_back(taken.origin.token, taken.header.sequence, context);
        }
    }
}
