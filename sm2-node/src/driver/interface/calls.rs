//! The calls of a client.

use sm2_proto::link::Role;
use sm2_proto::{GrowingMap, Name};

use super::links::Links;
use super::taken::Taken;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{Needs, Outbox};
use crate::driver::token::LinkToken;

/// The calls of a client whose outcome the program has not seen.
#[derive(Debug)]
pub(crate) struct Calls {
    open: GrowingMap<CallId, Option<Outcome>>,
    /// Whether the client may call the server of the node with this name.
    pub(crate) servers: fn(&Name) -> bool,
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
    /// No server accepts a request of this length; the greatest length that one accepts.
    TooLong { max_len: u64 },
    /// The program holds as many calls and replies of each server as it may.
    TooMany { limit: usize },
}

/// Identifies a call by its link and its number on that link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

impl Default for Calls {
    fn default() -> Self {
        Self {
            open: GrowingMap::new(),
            servers: |_| true,
        }
    }
}

impl Calls {
    /// Chooses the server for the next call, with a request of this length.
    //= SM2-SRV-005, SM2-SRV-006
    pub(crate) fn choose_server(&self, len: u64, links: &Links) -> Choice {
        let is_meant =
            |link: &&LinkDriver| link.is_open() && (self.servers)(&link.origin.peer.name);
        let open = || links.iter().filter(is_meant);
        // The choice and the limit use the same sum: otherwise a server whose replies are held would be
        // chosen and found full, while another one is free. Among links with equal sums, this is the oldest:
        // links are ordered by age.
        let load = |link: &LinkDriver| link.calls() + link.held();
        let accepting = open().filter(|link| link.accepts(len));
        let least = accepting.min_by_key(|link| load(link));
        match least {
            None => match open().map(LinkDriver::peer_max_len).max() {
                Some(max_len) => Choice::TooLong { max_len },
                None if links.is_opening() => Choice::Opening,
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

    /// Adds a call before its request is sent.
    pub(super) fn begin(&mut self, call: CallId) {
        self.open.insert(call, None);
    }

    /// Takes all replies from a caller's link, and notes the calls that failed with the link.
    pub(super) fn collect(
        &mut self,
        token: LinkToken,
        link: &mut LinkDriver,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if link.role() != Role::Caller {
            return;
        }
        if link.is_denied() {
            link.calls.failed.clear();
            return self.deny(token);
        }
        // `take` cannot fail because too many messages are held: a client makes no more calls than
        // it may hold replies.
        loop {
            let mut unwanted = None;
            let mut put = |reply: Taken| {
                let (id, place) = (reply.header.id, reply.place());
                if !self.finish(CallId { token, id }, Outcome::Reply(reply)) {
                    unwanted = place;
                }
            };
            if !matches!(
                link.take(&mut |_, _, _| (), &mut put, context, outbox),
                Ok(true)
            ) {
                break;
            }
            // No thread waits for this reply any more.
            if let Some(place) = unwanted {
                link.release(&[place], context.sets, outbox);
            }
        }
        //= SM2-SRV-004
        for id in link.calls.failed.drain(..) {
            self.finish(CallId { token, id }, Outcome::ServerGone);
        }
    }

    /// The access policy denies the link: its calls fail, also those whose replies the program has not
    /// seen.
    //= SM2-ACC-014
    fn deny(&mut self, token: LinkToken) {
        let calls = self.open.iter_mut().filter(|(call, _)| call.token == token);
        for (_, outcome) in calls {
            *outcome = Some(Outcome::ServerGone);
        }
    }

    /// Whether the call has an outcome that the program has not seen.
    pub(super) fn is_over(&self, call: CallId) -> bool {
        matches!(self.open.get(call), Some(Some(_)))
    }

    /// Whether the call has no outcome, and a thread may wait for it.
    pub(super) fn is_pending(&self, call: CallId) -> bool {
        matches!(self.open.get(call), Some(None))
    }

    /// Returns the outcome of a call once the call is over, and removes the call.
    pub(super) fn take(&mut self, call: CallId) -> Option<Outcome> {
        let outcome = self.open.get_mut(call)?.take()?;
        self.open.remove(call);
        Some(outcome)
    }

    /// Removes a call that no thread waits for any more. Returns its outcome, if the call is over.
    pub(super) fn remove(&mut self, call: CallId) -> Option<Outcome> {
        self.open.remove(call).flatten()
    }

    /// Records the outcome of a call. Returns whether a thread still waits for it.
    pub(super) fn finish(&mut self, call: CallId, outcome: Outcome) -> bool {
        match self.open.get_mut(call) {
            Some(open @ None) => {
                *open = Some(outcome);
                true
            }
            _ => false,
        }
    }
}
