use std::collections::BTreeMap;

use sm2_proto::link::Role;

use super::taken::Taken;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::Outbox;
use crate::driver::token::LinkToken;

/// The calls of a client whose outcome the program has not seen.
#[derive(Debug, Default)]
pub(crate) struct Calls {
    pub(super) open: BTreeMap<CallId, Option<Outcome>>,
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

impl Calls {
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
                let (id, sequence) = (reply.header.id, reply.header.sequence);
                if !self.finish(CallId { token, id }, Outcome::Reply(reply)) {
                    unwanted = Some(sequence);
                }
            };
            if !matches!(
                link.take(&mut |_, _, _| (), &mut put, context, outbox),
                Ok(true)
            ) {
                break;
            }
            // No thread waits for this reply any more.
            if let Some(sequence) = unwanted {
                link.release(&[(token, sequence)], context.sets, outbox);
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
        matches!(self.open.get(&call), Some(Some(_)))
    }

    /// Records the outcome of a call. Returns whether a thread still waits for it.
    pub(super) fn finish(&mut self, call: CallId, outcome: Outcome) -> bool {
        match self.open.get_mut(&call) {
            Some(open @ None) => {
                *open = Some(outcome);
                true
            }
            _ => false,
        }
    }
}
