//! Taking the messages of all links, in turn, and giving them back.

use std::sync::Arc;

use sm2_io::CounterEntry;
use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Delivery, Input, Role};
use sm2_proto::{Farewell, Instant};

use super::Interface;
use super::taken::{Full, Taken};
use crate::driver::context::Context;
use crate::driver::counters::note;
use crate::driver::token::LinkToken;

impl Interface {
    /// Takes the next message of any link, in turn.
    #[inline]
    pub(crate) fn take(&mut self, context: &mut Context<'_>) -> Result<Option<Taken>, Full> {
        let taken = self.next(context)?;
        self.note_taken(taken.as_slice(), |it| it.time, context);
        Ok(taken)
    }

    /// Takes messages until `all` has `most`, or no link has another one.
    pub(crate) fn take_many(
        &mut self,
        all: &mut Vec<Taken>,
        most: usize,
        context: &mut Context<'_>,
    ) -> Result<(), Full> {
        let before = all.len();
        let mut full = Ok(());
        while all.len() < most {
            match self.next(context) {
                Ok(Some(taken)) => all.push(taken),
                Ok(None) => break,
                Err(error) => {
                    full = Err(error);
                    break;
                }
            }
        }
        self.note_taken(&all[before..], |it| it.time, context);
        full
    }

    /// Counts messages that the application took and that were published at the given times.
    /// Consecutive messages of one link change the counters of this link only once.
    pub(super) fn note_taken(
        &mut self,
        all: &[Taken],
        published: impl Fn(&Delivery) -> Instant,
        context: &mut Context<'_>,
    ) {
        if all.is_empty() {
            return;
        }
        let now = context.now;
        let count = |entry: Option<&mut CounterEntry>, taken: &[Taken]| {
            note(entry, |entry| {
                for Taken { delivery, .. } in taken {
                    entry.taken(now, published(delivery), delivery.len);
                    if delivery.lost > 0 {
                        entry.lost(delivery.lost);
                    }
                }
            });
        };
        count(self.entry.as_mut(), all);
        let mut left = all;
        while let [first, rest @ ..] = left {
            let same = 1 + rest.iter().take_while(|it| it.token == first.token).count();
            let (taken, others) = left.split_at(same);
            let link = self.links.get_mut(first.token);
            count(link.and_then(|it| it.entry.as_mut()), taken);
            left = others;
        }
    }

    /// Takes the next message of any link, in turn, without counting it as taken by the
    /// application.
    #[inline]
    pub(super) fn next(&mut self, context: &mut Context<'_>) -> Result<Option<Taken>, Full> {
        let start = self.last_taken;
        let (mut visited, mut full) = (None, None);
        while let Some(link) = self.links.next_ready(start, visited) {
            let token = link.token();
            match link.take(context, &mut self.outbox) {
                Ok(Some((delivery, source))) => {
                    let taken = Taken {
                        token,
                        peer: Arc::clone(&link.peer),
                        delivery,
                        source,
                    };
                    // The link may be over, and this may have been its last message.
                    if link.end().is_some() {
                        self.settle_link(token, context);
                    }
                    self.last_taken = token;
                    self.lost += taken.delivery.lost;
                    self.events.push_loss(&taken.peer, taken.delivery.lost);
                    return Ok(Some(taken));
                }
                // There was no message after all, or the content of the ring ended the link.
                Ok(None) => self.settle_link(token, context),
                Err(error) => {
                    let peer = Arc::clone(&link.peer);
                    full = Some(Full { error, peer });
                }
            }
            if token == start {
                break;
            }
            visited = Some(token);
        }
        full.map_or(Ok(None), Err)
    }

    /// Gives a message back for the application.
    //= SM2-MSG-005
    #[inline]
    pub(crate) fn give_back(&mut self, token: LinkToken, sequence: u64, context: &mut Context<'_>) {
        self.give_back_all(&[(token, sequence)], context);
    }

    /// Gives messages back for the application. Consecutive messages of one link are one batch.
    //= SM2-MSG-005, SM2-RNG-015
    #[inline]
    pub(crate) fn give_back_all(&mut self, places: &[(LinkToken, u64)], context: &mut Context<'_>) {
        for batch in places.chunk_by(|it, next| it.0 == next.0) {
            let token = batch[0].0;
            let Some(link) = self.links.get_mut(token) else {
                continue;
            };
            link.release(batch, context.sets, &mut self.outbox);
            // On a receiver's link that is not over, a release has no further consequences.
            if link.role() != Role::Receiver || link.end().is_some() {
                self.settle_link(token, context);
            }
        }
    }

    /// Counts a message that was taken and cannot be mapped as lost. A shortage of memory costs this message
    /// alone; any other reason ends its link.
    //= SM2-TRN-014, SM2-SEG-007
    pub(crate) fn unreadable(
        &mut self,
        token: LinkToken,
        publisher: &Arc<LinkPeer>,
        is_shortage: bool,
        context: &mut Context<'_>,
    ) {
        self.lose(publisher, 1);
        if is_shortage {
            return;
        }
        self.with_link(token, context, |link, outbox, context| {
            let code = Farewell::Resources.code();
            link.feed(Input::Close(code), context.sets, outbox);
        });
    }
}
