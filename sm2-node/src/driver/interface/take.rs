//! Taking the messages of all links, in turn, and giving them back.

use std::sync::Arc;

use sm2_io::CounterEntry;
use sm2_proto::link::{Delivery, Input, Role};
use sm2_proto::{Farewell, Instant};

use super::Interface;
use super::taken::{Full, Taken};
use crate::driver::token::LinkToken;
use crate::driver::tools::Tools;

impl Interface {
    /// Takes the next message of any link, in turn.
    #[inline]
    pub(crate) fn take(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        let taken = self.next(tools)?;
        self.note_taken(taken.as_slice(), |it| it.time, tools);
        Ok(taken)
    }

    /// Takes messages until `all` has `most`, or no link has another one.
    pub(crate) fn take_many(
        &mut self,
        all: &mut Vec<Taken>,
        most: usize,
        tools: &mut Tools<'_>,
    ) -> Result<(), Full> {
        let before = all.len();
        let mut full = Ok(());
        while all.len() < most {
            match self.next(tools) {
                Ok(Some(taken)) => all.push(taken),
                Ok(None) => break,
                Err(error) => {
                    full = Err(error);
                    break;
                }
            }
        }
        self.note_taken(&all[before..], |it| it.time, tools);
        full
    }

    /// Counts messages that the application took and that were published at the given times.
    /// Consecutive messages of one link change the counters of this link only once.
    pub(super) fn note_taken(
        &self,
        all: &[Taken],
        published: impl Fn(&Delivery) -> Instant,
        tools: &mut Tools<'_>,
    ) {
        if all.is_empty() {
            return;
        }
        let now = tools.now;
        let mut note = |entry: Option<&CounterEntry>, taken: &[Taken]| {
            tools.counting.note(entry, |entry| {
                for Taken { delivery, .. } in taken {
                    entry.taken(now, published(delivery), delivery.len);
                    if delivery.lost > 0 {
                        entry.lost(delivery.lost);
                    }
                }
            });
        };
        note(self.entry.as_ref(), all);
        let mut left = all;
        while let [first, rest @ ..] = left {
            let count = 1 + rest.iter().take_while(|it| it.token == first.token).count();
            let (taken, others) = left.split_at(count);
            let link = self.links.get(first.token);
            note(link.and_then(|it| it.entry.as_ref()), taken);
            left = others;
        }
    }

    /// Takes the next message of any link, in turn, without counting it as taken by the
    /// application.
    #[inline]
    pub(super) fn next(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        let start = self.last_taken;
        let (mut visited, mut full) = (None, None);
        while let Some(link) = self.links.next_ready(start, visited) {
            let token = link.token();
            match link.take(tools, &mut self.outbox) {
                Ok(Some((delivery, source))) => {
                    let taken = Taken {
                        token,
                        peer: Arc::clone(&link.peer),
                        delivery,
                        source,
                    };
                    // The link may be over, and this may have been its last message.
                    if link.end().is_some() {
                        self.settle_link(token, tools);
                    }
                    self.last_taken = token;
                    self.lost += taken.delivery.lost;
                    return Ok(Some(taken));
                }
                // There was no message after all, or the content of the ring ended the link.
                Ok(None) => self.settle_link(token, tools),
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

    /// Handles a message that was taken and cannot be mapped, because this machine is out of
    /// memory. Closes its link.
    pub(crate) fn unreadable(&mut self, token: LinkToken, tools: &mut Tools<'_>) {
        self.lose(1, tools);
        self.with_link(token, tools, |link, outbox, tools| {
            let code = Farewell::Resources.code();
            link.feed(Input::Close(code), tools.epoll, outbox);
        });
    }
}
