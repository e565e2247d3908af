//! Receiving: the messages of all links, in turn.

use std::ops::Bound::{Excluded, Included, Unbounded};
use std::sync::Arc;

use sm2_proto::control::Peer;
use sm2_proto::link::{Delivery, Input, TooManyBorrowed};
use sm2_proto::{Farewell, Instant};

use super::interface::Interface;
use super::link::Tools;
use crate::payload::Source;

/// A message that the application holds.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) token: u64,
    pub(crate) peer: Arc<Peer>,
    pub(crate) delivery: Delivery,
    pub(crate) source: Source,
}

/// There is a message, but the application holds all that it may of this peer.
#[derive(Debug)]
pub(crate) struct Full {
    pub(crate) error: TooManyBorrowed,
    pub(crate) peer: Arc<Peer>,
}

impl Interface {
    /// The next message of any link, in turn.
    pub(crate) fn take(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        let taken = self.next(tools)?;
        if let Some(taken) = &taken {
            self.note_taken(taken, taken.delivery.time, tools);
        }
        Ok(taken)
    }

    /// The next messages, at most so many.
    pub(crate) fn take_many(
        &mut self,
        all: &mut Vec<Taken>,
        most: usize,
        tools: &mut Tools<'_>,
    ) -> Result<(), Full> {
        while all.len() < most {
            match self.take(tools)? {
                Some(taken) => all.push(taken),
                None => break,
            }
        }
        Ok(())
    }

    /// The application has a message, which was published at this moment.
    pub(super) fn note_taken(&self, taken: &Taken, published: Instant, tools: &mut Tools<'_>) {
        let (now, delivery) = (tools.now, &taken.delivery);
        let link = self.links.get(&taken.token);
        let link = link.and_then(|link| link.entry.as_ref());
        for entry in [self.entry.as_ref(), link] {
            tools.counting.note(entry, |entry| {
                entry.taken(now, published, delivery.len);
                entry.lost(delivery.lost);
            });
        }
    }

    /// The same, whether the application gets it or not.
    pub(super) fn next(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        let start = self.last_taken;
        let (mut position, mut wrapped, mut full) = (start, false, None);
        loop {
            let end = if wrapped { Included(start) } else { Unbounded };
            let mut links = self.links.range((Excluded(position), end));
            match links.find(|(_, link)| link.is_ready()) {
                Some((&token, _)) => {
                    position = token;
                    match self.take_from(token, tools) {
                        Err(error) => full = Some(error),
                        // What seemed to be one was none, or ended its link: others have theirs.
                        Ok(None) => {}
                        taken => return taken,
                    }
                }
                None if wrapped => break,
                // Tokens of links are greater than zero.
                None => (position, wrapped) = (0, true),
            }
        }
        full.map_or(Ok(None), Err)
    }

    fn take_from(&mut self, token: u64, tools: &mut Tools<'_>) -> Result<Option<Taken>, Full> {
        let Some(link) = self.links.get_mut(&token) else {
            return Ok(None);
        };
        let peer = Arc::clone(&link.peer);
        let (delivery, source) = match link.take(tools, &mut self.outbox) {
            Ok(Some(taken)) => taken,
            Ok(None) => {
                // Perhaps the link is over, by what was found in its ring.
                self.settle_link(token, tools);
                return Ok(None);
            }
            Err(error) => return Err(Full { error, peer }),
        };
        self.last_taken = token;
        self.lost += delivery.lost;
        // The last message of a link that is over was all that kept it.
        self.settle_link(token, tools);
        Ok(Some(Taken {
            token,
            peer,
            delivery,
            source,
        }))
    }

    /// A message that was taken cannot be shown: this machine is out of memory, and the link
    /// is closed for it.
    pub(crate) fn unreadable(&mut self, token: u64, tools: &mut Tools<'_>) {
        self.lose(1, tools);
        self.with_link(token, tools, |link, outbox, tools| {
            let code = Farewell::Resources.code();
            link.feed(Input::Close(code), tools.epoll, outbox);
        });
    }
}
