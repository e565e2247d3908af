//! Calls, from both ends: those that a client made, and the replies of a server.

mod ring;

use std::collections::HashMap;
use std::sync::Arc;

use bytes::Bytes;
use sm2_proto::Instant;
use sm2_proto::link::{Input, Role, Status};

use super::interface::Interface;
use super::link::{LinkDriver, Tools};
use super::outbox::{Forms, Label, Needs, Outbox};
use super::take::{Full, Taken};
use super::token::LinkToken;

/// The calls of a client that the program has not seen the end of.
#[derive(Debug, Default)]
pub(crate) struct Calls {
    open: HashMap<CallId, Option<Outcome>>,
}

/// One call: its link, and its number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CallId {
    pub(crate) token: LinkToken,
    pub(crate) id: u64,
}

/// How a call went.
#[derive(Debug)]
pub(crate) enum Outcome {
    Reply(Taken),
    ServerGone,
}

/// Which server a call goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Choice {
    /// This one, which needs this form.
    Link { token: LinkToken, needs: Needs },
    /// One is there, but not open yet.
    Opening,
    /// None is there.
    NoServer,
    /// The program holds as many calls and replies of each server as it may.
    TooMany { limit: usize },
}

impl Calls {
    /// Takes what a caller's link brought: replies, and the calls that ended with it.
    pub(super) fn collect(
        &mut self,
        token: LinkToken,
        link: &mut LinkDriver,
        tools: &mut Tools<'_>,
        outbox: &mut Outbox,
    ) {
        if link.role() != Role::Caller {
            return;
        }
        // No reply waits because too many are held: a client makes no more calls than it may
        // hold replies.
        while let Ok(Some((delivery, source))) = link.take(tools, outbox) {
            let (id, sequence) = (delivery.id, delivery.sequence);
            let reply = Taken {
                token,
                peer: Arc::clone(&link.peer),
                delivery,
                source,
            };
            if !self.finish(CallId { token, id }, Outcome::Reply(reply)) {
                // Nobody waits for it any more.
                link.release(sequence, tools.epoll, outbox);
            }
        }
        //= SM2-SRV-005
        for id in link.failed.drain(..) {
            self.finish(CallId { token, id }, Outcome::ServerGone);
        }
    }

    /// Whether somebody waits for it.
    fn finish(&mut self, call: CallId, outcome: Outcome) -> bool {
        match self.open.get_mut(&call) {
            Some(open @ None) => {
                *open = Some(outcome);
                true
            }
            _ => false,
        }
    }
}

impl Interface {
    /// The server that the next call goes to.
    //= SM2-SRV-001
    pub(crate) fn choose_server(&self) -> Choice {
        let is_meant = |link: &&LinkDriver| link.is_open() && (self.servers)(&link.peer.name);
        let open = || self.links().filter(is_meant);
        // Of several with as few calls the oldest: links are in the order of their age.
        let least = open().min_by_key(|link| link.calls());
        match least {
            None if self.is_opening() => Choice::Opening,
            None => Choice::NoServer,
            Some(link) if link.calls() + link.held() >= link.max_borrowed() => Choice::TooMany {
                limit: link.max_borrowed(),
            },
            Some(link) => Choice::Link {
                token: link.token(),
                needs: link.needs(),
            },
        }
    }

    /// Makes a call on this link.
    pub(crate) fn call(
        &mut self,
        token: LinkToken,
        forms: Forms,
        len: u64,
        deadline: Option<Instant>,
        tools: &mut Tools<'_>,
    ) -> CallId {
        let id = self.link(token).map_or(0, |link| link.last_call) + 1;
        let call = CallId { token, id };
        self.calls.open.insert(call, None);
        let label = Label {
            id,
            // Zero is none.
            time: deadline.unwrap_or_default(),
            len,
        };
        let key = self.outbox.store(forms, label);
        let sent = self.with_link(token, tools, |link, outbox, tools| {
            link.last_call = id;
            link.send(key, Status::Ok, tools, outbox);
        });
        let now = sm2_io::clock::now();
        (tools.counting).note(self.entry.as_ref(), |entry| entry.published(now, len));
        self.outbox.release(key);
        // The link ended before the machine had the call: it does not speak of it.
        let over = self.link(token).is_none_or(|link| link.end().is_some());
        if sent.is_none() || over {
            self.calls.finish(call, Outcome::ServerGone);
        }
        call
    }

    /// How a call went, once it is over; it is forgotten then.
    pub(crate) fn outcome(&mut self, call: CallId, tools: &mut Tools<'_>) -> Option<Outcome> {
        if self.link(call.token).is_some_and(LinkDriver::is_ready) {
            self.settle_link(call.token, tools);
        }
        let outcome = self.calls.open.get_mut(&call)?.take()?;
        self.calls.open.remove(&call);
        Some(outcome)
    }

    /// The program no longer wants the reply.
    pub(crate) fn cancel(&mut self, call: CallId, tools: &mut Tools<'_>) {
        let CallId { token, id } = call;
        if self.calls.open.get(&call).is_some_and(Option::is_none) {
            self.with_link(token, tools, |link, outbox, tools| {
                link.feed(Input::Cancel { call: id }, tools.epoll, outbox);
            });
        }
    }

    /// Nobody waits for the call any more: a reply that comes, or came, is given back.
    pub(crate) fn forget(&mut self, call: CallId, tools: &mut Tools<'_>) {
        self.cancel(call, tools);
        if let Some(Some(Outcome::Reply(taken))) = self.calls.open.remove(&call) {
            self.give_back(taken.token, taken.delivery.sequence, tools);
        }
    }

    /// The next request that is worth the server's time.
    pub(crate) fn take_request(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        while let Some(taken) = self.next(tools)? {
            let (token, id) = (taken.token, taken.delivery.id);
            let deadline = taken.delivery.time;
            let cancelled = self.is_cancelled(CallId { token, id });
            let late = deadline.0 != 0 && deadline <= sm2_io::clock::now();
            //= SM2-SRV-003
            let status = match (cancelled, late) {
                (true, _) => Status::Cancelled,
                (false, true) => Status::DeadlinePassed,
                (false, false) => {
                    // A request says when it is too late, not when it was made.
                    let now = sm2_io::clock::now();
                    self.note_taken(std::slice::from_ref(&taken), |_| now, tools);
                    return Ok(Some(taken));
                }
            };
            self.reply_bare(CallId { token, id }, status, tools);
            self.give_back(token, taken.delivery.sequence, tools);
        }
        Ok(None)
    }

    /// Whether the client no longer wants the reply, or is gone.
    pub(crate) fn is_cancelled(&self, call: CallId) -> bool {
        match self.link(call.token) {
            Some(link) => link.end().is_some() || link.cancelled.contains(&call.id),
            None => true,
        }
    }

    /// Replies without a payload.
    pub(crate) fn reply_bare(&mut self, call: CallId, status: Status, tools: &mut Tools<'_>) {
        let forms = Forms {
            inline: Some(Bytes::new()),
            ..Forms::default()
        };
        self.reply(call, forms, 0, status, tools);
    }

    /// Replies that the call failed.
    pub(crate) fn reply_failed(
        &mut self,
        call: CallId,
        reason: &'static str,
        tools: &mut Tools<'_>,
    ) {
        let forms = Forms {
            inline: Some(Bytes::from_static(reason.as_bytes())),
            ..Forms::default()
        };
        self.reply(call, forms, reason.len() as u64, Status::Failed, tools);
    }

    /// Replies; whether the client was still there.
    pub(crate) fn reply(
        &mut self,
        call: CallId,
        forms: Forms,
        len: u64,
        status: Status,
        tools: &mut Tools<'_>,
    ) -> bool {
        let label = Label {
            id: call.id,
            time: sm2_io::clock::now(),
            len,
        };
        let key = self.outbox.store(forms, label);
        let sent = self.with_link(call.token, tools, |link, outbox, tools| {
            link.cancelled.remove(&call.id);
            let open = link.is_open();
            if open {
                link.send(key, status, tools, outbox);
            }
            open
        });
        self.outbox.release(key);
        sent == Some(true)
    }

    /// The application gives a message back.
    //= SM2-MSG-005
    pub(crate) fn give_back(&mut self, token: LinkToken, sequence: u64, tools: &mut Tools<'_>) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        link.release(sequence, tools.epoll, &mut self.outbox);
        // On a receiver's link that goes on nothing follows from it.
        if link.role() != Role::Receiver || link.end().is_some() {
            self.settle_link(token, tools);
        }
    }
}
