//! Publishing a message on all links of a publisher.

use sm2_proto::Instant;
use sm2_proto::link::{Fate, Input, Status};

use super::DeclaredInterface;
use super::limit::Holders;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{Forms, Label, MessageKey, Needs, Outbox};
use crate::driver::token::LinkToken;
use crate::published::Published;

/// A publication that was not sent to all links yet.
#[derive(Debug, Default)]
pub(crate) struct Offered {
    /// The stored message; `None` if no link needed it.
    key: Option<MessageKey>,
    pub(super) links: usize,
    pub(super) missed: usize,
    /// Links whose subscriber does not accept messages of this length.
    pub(super) too_long: usize,
    /// Reliable links without room.
    pub(crate) waiting: Vec<LinkToken>,
    /// Whether a link has ended during the publication.
    pub(super) has_ended: bool,
}

impl Offered {
    /// The result for the program.
    pub(super) const fn published(&self) -> Published {
        Published {
            links: self.links,
            missed: self.missed,
            too_long: self.too_long,
        }
    }

    /// Offers a stored message to an open link.
    pub(super) fn offer(
        &mut self,
        key: MessageKey,
        len: u64,
        link: &mut LinkDriver,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if !link.accepts(len) {
            link.drop_too_long(len, context, outbox);
            return self.count_too_long(link);
        }
        if link.is_resuming() {
            link.resume_if_released();
            outbox.recheck();
        }
        //= SM2-QOS-002, SM2-QOS-003
        // Links with room get the message first. Of the others, a link that owes is skipped at once.
        if !link.is_reliable() && link.is_suspended() {
            link.drop_publication(Fate::PoolLimit, context, outbox);
        } else if !link.is_reliable() || link.has_room() {
            link.send(key, Status::Ok, context, outbox);
            link.watch_in_background(context.sets);
            self.links += usize::from(link.is_open());
        } else if link.owes() {
            link.drop_without_room(context, outbox);
            self.missed += 1;
        } else {
            self.waiting.push(link.token());
        }
    }

    /// Counts a link whose subscriber does not accept messages of this length.
    pub(super) fn count_too_long(&mut self, link: &LinkDriver) {
        self.too_long += 1;
        self.missed += usize::from(link.is_reliable());
    }
}

impl DeclaredInterface {
    /// The forms that the open links need for a message of this length. If none needs any and
    /// messages are latched, the needs of a link that opens later.
    pub(crate) fn needs(&self, len: u64) -> Needs {
        let mut needs = Needs::default();
        let open = self.links.iter().filter(|link| link.is_open());
        for link in open.filter(|link| link.accepts(len)) {
            if !link.is_suspended() || link.is_reliable() {
                needs.add(link.needs());
            }
        }
        if needs.nobody() && self.latched.is_used() {
            needs.add(Needs::of(self.contract.sealed()));
        }
        needs
    }

    /// Frees memory for a message of this length: settles what came back, and suspends links if
    /// that is due.
    pub(crate) fn prepare_memory(&mut self, len: u64, context: &mut Context<'_>) {
        if self.outbox.is_check_due(len) {
            self.harvest(context);
            self.suspend_holders(len);
        }
    }

    /// Suspends the links that hold too much for a message of this length, if that is due.
    pub(super) fn suspend_holders(&mut self, len: u64) {
        if self.outbox.is_check_due(len) {
            Holders::suspend(len, &mut self.links, &mut self.outbox, &self.latched);
        }
    }

    /// Whether a publication would not wait: each reliable link has room, or owes.
    pub(crate) fn has_room(&self) -> bool {
        !self.links.iter().any(LinkDriver::delays_publication)
    }

    /// Offers a message to every open link. The caller must [finish](Self::finish) the returned
    /// publication.
    pub(crate) fn publish(
        &mut self,
        forms: Forms,
        time: Instant,
        len: u64,
        context: &mut Context<'_>,
    ) -> Offered {
        self.published += 1;
        if forms.is_empty() {
            let is_heard = self.links.count_open() > 0;
            let offered = self.publish_to_nobody(len, context);
            self.count_publication(time, len, is_heard, context);
            return offered;
        }
        let id = self.published;
        let key = self.outbox.store(forms, Label { id, time, len });
        self.latched.push(key, &mut self.outbox);
        let mut offered = Offered {
            key: Some(key),
            ..Offered::default()
        };
        let mut is_heard = false;
        for link in self.links.iter_mut() {
            if link.is_open() {
                is_heard = true;
                offered.offer(key, len, link, context, &mut self.outbox);
            }
            offered.has_ended |= link.is_over_unnoticed();
        }
        // After the words are in the rings: the receivers need not wait for it.
        self.count_publication(time, len, is_heard, context);
        self.detach_segments(context);
        offered
    }

    /// Counts a message without a form on the open links: each of them is suspended, or does not
    /// accept messages of this length.
    fn publish_to_nobody(&mut self, len: u64, context: &mut Context<'_>) -> Offered {
        let mut offered = Offered::default();
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            if !link.accepts(len) {
                link.drop_too_long(len, context, &mut self.outbox);
                offered.count_too_long(link);
            } else if link.is_suspended() {
                link.drop_publication(Fate::PoolLimit, context, &mut self.outbox);
            }
            offered.has_ended |= link.is_over_unnoticed();
        }
        offered
    }

    /// Counts a message that finds no memory, on every open link that accepts its length. `None` if no link
    /// holds a message: then the publisher itself uses the memory.
    //= SM2-QOS-007
    pub(crate) fn miss(
        &mut self,
        time: Instant,
        len: u64,
        context: &mut Context<'_>,
    ) -> Option<Published> {
        if !self.links.hold_memory() {
            return None;
        }
        self.published += 1;
        self.count_publication(time, len, self.links.count_open() > 0, context);
        let mut published = Published::default();
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            if link.accepts(len) {
                link.drop_publication(Fate::PoolLimit, context, &mut self.outbox);
            } else {
                link.drop_too_long(len, context, &mut self.outbox);
                published.too_long += 1;
            }
            published.missed += usize::from(link.is_reliable());
        }
        self.reports.report_drops(&mut self.links);
        Some(published)
    }

    /// Counts a publication, and whether a link was open for it. It asserts the liveliness of the publisher.
    //= SM2-QOS-009, SM2-QOS-011, SM2-QOS-012
    #[inline]
    pub(super) fn count_publication(
        &mut self,
        time: Instant,
        len: u64,
        is_heard: bool,
        context: &mut Context<'_>,
    ) {
        let was_alive = self.qos.publish(time);
        if self.qos.has_lease() {
            // Its subscribers learn at once that it is alive again.
            if !was_alive {
                self.assert_liveliness(time, context);
            }
            // ALIVE may have been held back on a link that does not get the message.
            self.ask_for_tick();
        }
        self.reports.count_publication(time, len, is_heard);
    }

    /// The program asserts the liveliness of its publisher at this time.
    //= SM2-QOS-011, SM2-QOS-012
    pub(crate) fn assert_liveliness(&mut self, time: Instant, context: &mut Context<'_>) {
        self.qos.assert(time, &mut self.reports);
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            link.feed(Input::Assert(time), context.sets, &mut self.outbox);
        }
        self.notice_ends(context);
        self.ask_for_tick();
    }

    /// Sends the message to the links that have room now. Returns whether no link is left to wait
    /// for.
    pub(crate) fn publish_more(
        &mut self,
        offered: &mut Offered,
        context: &mut Context<'_>,
    ) -> bool {
        let Some(key) = offered.key else {
            return true;
        };
        let (links, has_ended) = (&mut offered.links, &mut offered.has_ended);
        offered.waiting.retain(|token| {
            let Some(link) = self.links.get_mut(*token).filter(|link| link.is_open()) else {
                return false;
            };
            let room = link.has_room();
            if room {
                link.send(key, Status::Ok, context, &mut self.outbox);
                *links += usize::from(link.is_open());
                *has_ended |= link.is_over_unnoticed();
            }
            !room
        });
        offered.waiting.is_empty()
    }

    /// Frees memory that was unused for long. Cheap enough to call with every message.
    #[inline]
    pub(crate) fn free_idle(&mut self, now: Instant, context: &mut Context<'_>) {
        self.outbox.free_idle(now);
        self.detach_segments(context);
    }

    /// Frees the memory of a message that is not sent.
    pub(crate) fn drop_forms(&mut self, forms: Forms, context: &mut Context<'_>) {
        if let Some(lease) = forms.pooled {
            self.outbox.unlease(lease);
            self.detach_segments(context);
        }
    }

    /// Ends a publication: links that still have no room miss this message.
    pub(crate) fn finish(&mut self, mut offered: Offered, context: &mut Context<'_>) -> Published {
        if !offered.waiting.is_empty() {
            self.publish_more(&mut offered, context);
            for token in offered.waiting.drain(..) {
                if let Some(link) = self.links.get_mut(token) {
                    link.drop_without_room(context, &mut self.outbox);
                    offered.missed += 1;
                    offered.has_ended |= link.is_over_unnoticed();
                }
            }
        }
        if let Some(key) = offered.key {
            self.outbox.release(key);
        }
        if offered.has_ended {
            self.notice_ends(context);
        }
        self.detach_segments(context);
        self.reports.report_drops(&mut self.links);
        offered.published()
    }
}
