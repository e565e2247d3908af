//! Calls at both ends: the calls of a client, and the replies of a server.

mod ring;

use std::collections::HashMap;
use std::sync::Arc;

use bytes::Bytes;
use sm2_io::Epoll;
use sm2_proto::link::{Input, Role, Status};
use sm2_proto::{Instant, InterfaceId};

use super::Inner;
use super::interface::Interface;
use super::link::{LinkDriver, Tools};
use super::outbox::{Forms, Label, Needs, Outbox};
use super::take::{Full, Taken};
use super::token::LinkToken;

/// The calls of a client whose outcome the program has not seen.
#[derive(Debug, Default)]
pub(crate) struct Calls {
    open: HashMap<CallId, Option<Outcome>>,
}

/// Identifies a call by its link and its number on that link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct CallId {
    pub(crate) token: LinkToken,
    pub(crate) id: u64,
}

/// The outcome of a call.
#[derive(Debug)]
pub(crate) enum Outcome {
    Reply(Taken),
    ServerGone,
}

/// The server for the next call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Choice {
    /// The call goes to the server of this link, which needs these forms.
    Link { token: LinkToken, needs: Needs },
    /// A server exists, but no link to a server is open yet.
    Opening,
    /// There is no server.
    NoServer,
    /// The program holds as many calls and replies of each server as it may.
    TooMany { limit: usize },
}

impl Calls {
    /// Takes all replies from a caller's link, and notes the calls that failed with the link.
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
        // `take` cannot fail because too many messages are held: a client makes no more calls than
        // it may hold replies.
        while let Ok(Some((delivery, source))) = link.take(tools, outbox) {
            let (id, sequence) = (delivery.id, delivery.sequence);
            let reply = Taken {
                token,
                peer: Arc::clone(&link.peer),
                delivery,
                source,
            };
            if !self.finish(CallId { token, id }, Outcome::Reply(reply)) {
                // No thread waits for this reply any more.
                link.release(sequence, tools.epoll, outbox);
            }
        }
        //= SM2-SRV-005
        for id in link.failed.drain(..) {
            self.finish(CallId { token, id }, Outcome::ServerGone);
        }
    }

    /// Records the outcome of a call. Returns whether a thread still waits for it.
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

impl Inner {
    /// Chooses the server for the next call of a client. While a link to the first server is
    /// announced and has not come, also asks the Manager for a PAGE, with which
    /// [`is_opening`](Interface::is_opening) ends: the link may never come.
    pub(crate) fn choose_server(&mut self, client: InterfaceId, epoll: &Epoll) -> Option<Choice> {
        let interface = self.interfaces.get(&client)?;
        let choice = interface.choose_server();
        if choice == Choice::Opening && interface.links_due > 0 {
            self.expect_page(epoll);
        }
        Some(choice)
    }
}

impl Interface {
    /// Chooses the server for the next call.
    //= SM2-SRV-006
    pub(crate) fn choose_server(&self) -> Choice {
        let is_meant = |link: &&LinkDriver| link.is_open() && (self.servers)(&link.peer.name);
        let open = || self.links().filter(is_meant);
        // The choice and the limit use the same sum: otherwise a server whose replies are held would be
        // chosen and found full, while another one is free. Among links with equal sums, this is the oldest:
        // links are ordered by age.
        let load = |link: &LinkDriver| link.calls() + link.held();
        let least = open().min_by_key(|link| load(link));
        match least {
            None if self.is_opening() => Choice::Opening,
            None => Choice::NoServer,
            Some(link) if load(link) >= link.max_borrowed() => Choice::TooMany {
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
            // Zero means no deadline.
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
        // If the link ended before the machine accepted the call, no output reports the call.
        let over = self.link(token).is_none_or(|link| link.end().is_some());
        if sent.is_none() || over {
            self.calls.finish(call, Outcome::ServerGone);
        }
        call
    }

    /// Returns the outcome of a call once the call is over, and removes the call.
    pub(crate) fn outcome(&mut self, call: CallId, tools: &mut Tools<'_>) -> Option<Outcome> {
        if self.link(call.token).is_some_and(LinkDriver::is_ready) {
            self.settle_link(call.token, tools);
        }
        let outcome = self.calls.open.get_mut(&call)?.take()?;
        self.calls.open.remove(&call);
        Some(outcome)
    }

    /// Called when the program no longer wants the reply.
    pub(crate) fn cancel(&mut self, call: CallId, tools: &mut Tools<'_>) {
        let CallId { token, id } = call;
        if self.calls.open.get(&call).is_some_and(Option::is_none) {
            self.with_link(token, tools, |link, outbox, tools| {
                link.feed(Input::Cancel { call: id }, tools.epoll, outbox);
            });
        }
    }

    /// Removes a call for which no thread waits any more. Gives its reply back if the reply has
    /// come, or when it comes.
    pub(crate) fn forget(&mut self, call: CallId, tools: &mut Tools<'_>) {
        self.cancel(call, tools);
        if let Some(Some(Outcome::Reply(taken))) = self.calls.open.remove(&call) {
            self.give_back(taken.token, taken.delivery.sequence, tools);
        }
    }

    /// Takes the next request that is neither cancelled nor late. Answers cancelled and late
    /// requests with a reply that has no payload.
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
                    // A request carries its deadline, not the time at which it was sent.
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

    /// Sends a reply without a payload.
    pub(crate) fn reply_bare(&mut self, call: CallId, status: Status, tools: &mut Tools<'_>) {
        let forms = Forms {
            inline: Some(Bytes::new()),
            ..Forms::default()
        };
        self.reply(call, forms, 0, status, tools);
    }

    /// Sends a reply that says that the call failed.
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

    /// Sends a reply. Returns whether the client's link was still open.
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

    /// Gives a message back for the application.
    //= SM2-MSG-005
    pub(crate) fn give_back(&mut self, token: LinkToken, sequence: u64, tools: &mut Tools<'_>) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        link.release(sequence, tools.epoll, &mut self.outbox);
        // On a receiver's link that is not over, a release has no further consequences.
        if link.role() != Role::Receiver || link.end().is_some() {
            self.settle_link(token, tools);
        }
    }
}
