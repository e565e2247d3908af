//! Taking the messages of all links, in turn, and giving them back.

use std::io;
use std::sync::Arc;

use sm2_proto::Contract;
use sm2_proto::control::LinkPeer;

use super::DeclaredInterface;
use super::taken::{Full, Header, Taken};
use crate::driver::context::Context;
use crate::driver::datagram::Incoming;
use crate::driver::token::LinkToken;

impl DeclaredInterface {
    /// Takes the next message of any link, in turn, and passes it to `put`. Returns whether there was one.
    ///
    /// A message of a topic counts as taken. A server counts a request once it is neither cancelled nor late.
    #[inline]
    pub(crate) fn take(
        &mut self,
        put: &mut impl FnMut(Taken),
        context: &mut Context<'_>,
    ) -> Result<bool, Full> {
        let start = self.last_taken;
        let is_topic = matches!(self.contract, Contract::Subscriber { .. });
        let (mut visited, mut full) = (None, None);
        while let Some(link) = self.links.next(start, visited) {
            let (token, now) = (link.token(), context.now);
            let mut count = |header: &Header, away: u64, peer: &Arc<LinkPeer>| {
                (self.reports).count_taken(peer, header, away, now, is_topic);
            };
            match link.take(&mut count, put, context, &mut self.outbox) {
                Ok(true) => {
                    // This may have been the last message of a link that is over.
                    if link.end().is_some() {
                        self.settle_link(token, context);
                    }
                    self.last_taken = token;
                    return Ok(true);
                }
                // The content of the ring ended the link, or its socket was read.
                Ok(false) if link.end().is_some() || context.socket_read => {
                    self.settle_link(token, context);
                }
                Ok(false) => {}
                Err(error) => {
                    let peer = Arc::clone(&link.origin.peer);
                    full = Some(Full { error, peer });
                }
            }
            if token == start {
                break;
            }
            visited = Some(token);
        }
        full.map_or(Ok(false), Err)
    }

    /// Takes messages until `all` has `most`, or no link has another one.
    pub(crate) fn take_many(
        &mut self,
        all: &mut Vec<Taken>,
        most: usize,
        context: &mut Context<'_>,
    ) -> Result<(), Full> {
        while all.len() < most && self.take(&mut |taken| all.push(taken), context)? {}
        Ok(())
    }

    /// Gives a message back for the application.
    //= SM2-MSG-005
    #[inline]
    pub(crate) fn give_back(&mut self, token: LinkToken, sequence: u64, context: &mut Context<'_>) {
        self.give_back_batch(token, &[(token, sequence)], context);
    }

    /// Gives messages back for the application. Consecutive messages of one link are one batch.
    //= SM2-MSG-005, SM2-RNG-012
    pub(crate) fn give_back_all(&mut self, places: &[(LinkToken, u64)], context: &mut Context<'_>) {
        for batch in places.chunk_by(|it, next| it.0 == next.0) {
            self.give_back_batch(batch[0].0, batch, context);
        }
    }

    #[inline]
    fn give_back_batch(
        &mut self,
        token: LinkToken,
        batch: &[(LinkToken, u64)],
        context: &mut Context<'_>,
    ) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        link.release(batch, context.sets, &mut self.outbox);
        if !link.is_settled() {
            self.settle_link(token, context);
        }
    }

    /// Counts a message that was taken and cannot be mapped as lost, and ends its link.
    pub(crate) fn unreadable(
        &mut self,
        token: LinkToken,
        publisher: &Arc<LinkPeer>,
        error: &io::Error,
        context: &mut Context<'_>,
    ) {
        self.reports.lose(publisher, 1, 0);
        self.with_link(token, context, |link, outbox, context| {
            link.refuse_file(error);
            link.drain(Incoming::default(), context.sets, outbox);
        });
    }
}
