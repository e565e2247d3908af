//! Plain lists of the messages sent in one direction: the stage of each message, and its expected
//! fate.

use std::collections::VecDeque;

use sm2_proto::link::{Counters, Delivery, Fate, Status, wire::Given};

use super::{
    super::{Failure, Property},
    Form, LinkScope, fail,
    pool::Slot,
};

/// The limits that both ends of one direction have agreed on.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlowLimits {
    /// True if replies are sent in this direction.
    pub(super) replies: bool,
    /// True if publications are sent in this direction.
    pub(super) data: bool,
    displaces: bool,
    /// The number of messages that may wait for the window.
    waiting: usize,
    /// The number of messages that may be ready, if the next one displaces one.
    ready: usize,
    max_borrowed: usize,
    window: usize,
}

impl FlowLimits {
    /// The limits of the messages that end `from` sends.
    pub(super) fn new(scope: &LinkScope, from: usize) -> Self {
        let [ours, theirs] = [scope.config(from), scope.config(1 - from)];
        Self {
            replies: scope.is_service() && from == 1,
            data: !scope.is_service(),
            displaces: !scope.is_service() && !scope.reliable,
            waiting: match scope.is_service() {
                true => 1_024,
                false => usize::from(ours.depth),
            },
            ready: usize::from(theirs.depth),
            max_borrowed: usize::from(theirs.max_borrowed),
            window: usize::from(theirs.depth) + usize::from(theirs.max_borrowed),
        }
    }

    /// The property that is broken if a message other than the next one arrives.
    const fn order(&self) -> Property {
        match self.replies {
            true => Property::CallsEndOnce,
            false => Property::MessagesInOrder,
        }
    }
}

/// The stage of a message. The number is its `sequence`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// It waits in the sender's machine.
    Queued,
    /// The sender's driver keeps it, because the socket is full.
    Kept(u64),
    OnTheWire(u64),
    /// It can be taken.
    Ready(u64),
    /// The application holds it.
    Held(u64),
    /// It was released, or was displaced before it was taken.
    Back(u64, Given),
    /// A RELEASE that names it was sent.
    Named(Given),
    /// It was lost.
    Gone,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Entry {
    /// The id, which is also the driver's key for the message, and its content.
    pub(super) id: u64,
    pub(super) form: Form,
    pub(super) slot: Option<Slot>,
    pub(super) status: Status,
    pub(super) stage: Stage,
    /// The fate that was reported to the sender.
    pub(super) fate: Option<Fate>,
    /// Whether it was in flight when a deadline last passed.
    pub(super) owed: bool,
}

/// The room for one more message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Room {
    Free,
    /// There is room if this message, the oldest that waits, is displaced.
    Displaces(u64),
    None,
}

/// All messages of one direction that matter to at least one end.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Flow {
    pub(super) entries: VecDeque<Entry>,
    /// Counters of all messages ever sent in this direction. `in_flight` is not counted here.
    tally: Counters,
    /// The number of the last message that left its machine.
    sequence: u64,
    /// The id of the next message if none is lost.
    next_id: Option<u64>,
    /// The displaced message that must be reported within the same step.
    pub(super) displaced: Option<u64>,
    pub(super) discarded: Option<u64>,
}

impl Flow {
    fn unsettled(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|it| it.fate.is_none())
    }

    pub(super) fn queued(&self) -> impl Iterator<Item = &Entry> {
        self.unsettled().filter(|it| it.stage == Stage::Queued)
    }

    /// The number of messages that were sent and not released.
    fn unreleased(&self) -> usize {
        self.unsettled().count() - self.queued().count()
    }

    /// Returns the room at the sender, which knows the window only after OPEN.
    //= SM2-QOS-001, SM2-QOS-002 model
    pub(super) fn room(&self, limits: &FlowLimits, opened: bool) -> Room {
        let window = if opened { limits.window } else { 0 };
        let admitted = window.saturating_sub(self.unreleased());
        let mut waiting = self.queued().skip(admitted);
        let oldest = waiting.next();
        let count = usize::from(oldest.is_some()) + waiting.count();
        match oldest {
            _ if count < limits.waiting || self.unsettled().count() < window => Room::Free,
            Some(oldest) if limits.displaces => Room::Displaces(oldest.id),
            _ => Room::None,
        }
    }

    /// Records that the application gave its machine a message.
    pub(super) fn offered(&mut self, entry: Entry, room: Room) {
        self.tally.offered += 1;
        if let Room::Displaces(id) = room {
            self.displaced = Some(id);
        }
        self.entries.push_back(entry);
    }

    /// Records that a deadline passed.
    pub(super) fn skipped(&mut self) {
        self.tally.offered += 1;
        self.tally.no_room += 1;
        for entry in self.entries.iter_mut().filter(|it| it.fate.is_none()) {
            entry.owed = true;
        }
    }

    /// Whether the link owes.
    //= SM2-QOS-003 model
    pub(super) fn owes(&self) -> bool {
        self.unsettled().any(|it| it.owed)
    }

    /// Records that the machine handed out the packet of a message.
    //= SM2-MSG-001, SM2-MSG-003 model
    pub(super) fn handed_out(
        &mut self,
        (sequence, id): (u64, u64),
        limits: &FlowLimits,
        opened: bool,
    ) -> Result<(), Failure> {
        let unreleased = self.unreleased();
        if !opened || unreleased >= limits.window {
            let what = format!("message {id} is sent, {unreleased} are unreleased");
            return fail(Property::WithinWindow, what);
        }
        self.sequence += 1;
        let next = self.sequence;
        let mut entries = self.entries.iter_mut();
        match entries.find(|it| it.stage == Stage::Queued && it.fate.is_none()) {
            Some(entry) if entry.id == id && next == sequence => entry.stage = Stage::Kept(next),
            other => {
                let what = format!("message {sequence} with id {id} is sent, not {other:?}");
                return fail(limits.order(), what);
            }
        }
        Ok(())
    }

    /// Moves the message at stage `from` to stage `to`.
    pub(super) fn moved(&mut self, from: Stage, to: Stage) {
        let mut entries = self.entries.iter_mut();
        if let Some(entry) = entries.find(|it| it.stage == from) {
            entry.stage = to;
        }
    }

    /// Records that the reader's machine accepted a message.
    //= SM2-MSG-001, SM2-MSG-002, SM2-MSG-003, SM2-QOS-001 model
    pub(super) fn accepted(
        &mut self,
        (sequence, id): (u64, u64),
        limits: &FlowLimits,
    ) -> Result<(), Failure> {
        let on_the_wire = |it: &&mut Entry| matches!(it.stage, Stage::OnTheWire(_));
        let next = self.entries.iter_mut().find(on_the_wire);
        match next {
            Some(entry) if entry.stage == Stage::OnTheWire(sequence) && entry.id == id => {
                entry.stage = Stage::Ready(sequence);
            }
            other => {
                let what = format!("message {sequence} with id {id} came, not {other:?}");
                return fail(limits.order(), what);
            }
        }
        self.next_id.get_or_insert(id);
        if limits.displaces && self.ready() > limits.ready {
            self.displace();
        }
        let here =
            |it: &&Entry| matches!(it.stage, Stage::Ready(_) | Stage::Held(_) | Stage::Back(..));
        match self.entries.iter().filter(here).count() {
            count if count > limits.window => fail(
                Property::WithinWindow,
                format!("{count} messages are with the reader"),
            ),
            _ => Ok(()),
        }
    }

    /// Displaces the oldest message that was not taken.
    fn displace(&mut self) {
        for entry in &mut self.entries {
            if let Stage::Ready(sequence) = entry.stage {
                entry.stage = Stage::Back(sequence, Given::Discarded);
                self.discarded = Some(sequence);
                return;
            }
        }
    }

    /// The number of messages that can be taken.
    pub(super) fn ready(&self) -> usize {
        let ready = |it: &&Entry| matches!(it.stage, Stage::Ready(_));
        self.entries.iter().filter(ready).count()
    }

    /// The messages that the application holds.
    pub(super) fn held(&self) -> impl Iterator<Item = u64> {
        self.entries.iter().filter_map(|it| match it.stage {
            Stage::Held(sequence) => Some(sequence),
            _ => None,
        })
    }

    /// True if the application may take one more message.
    pub(super) fn may_take(&self, limits: &FlowLimits) -> bool {
        self.held().count() < limits.max_borrowed
    }

    /// Records that the application took a message, and returns it.
    //= SM2-MSG-002, SM2-MSG-005 model
    pub(super) fn taken(&mut self, it: &Delivery, limits: &FlowLimits) -> Result<Entry, Failure> {
        if !self.may_take(limits) {
            let what = format!("message {} is taken, one too many", it.sequence);
            return fail(Property::WithinWindow, what);
        }
        let lost = match self.next_id {
            Some(next) if limits.data => it.id.saturating_sub(next),
            _ => 0,
        };
        let mut entries = self.entries.iter_mut();
        let oldest = entries.find(|it| matches!(it.stage, Stage::Ready(_)));
        let Some(entry) = oldest.filter(|entry| {
            entry.stage == Stage::Ready(it.sequence)
                && (entry.id, entry.status) == (it.id, it.status)
                && it.lost == lost
        }) else {
            return fail(limits.order(), format!("{it:?} is taken, {lost} were lost"));
        };
        entry.stage = Stage::Held(it.sequence);
        self.next_id = Some(it.id + 1);
        Ok(*entry)
    }

    /// Records that the application released a message. `over` is true if the link has ended.
    pub(super) fn given_back(&mut self, sequence: u64, over: bool) {
        let to = match over {
            true => Stage::Gone,
            false => Stage::Back(sequence, Given::Consumed),
        };
        self.moved(Stage::Held(sequence), to);
    }

    /// Records that a RELEASE that names this message was sent.
    //= SM2-MSG-004 model
    pub(super) fn named(&mut self, sequence: u64, given: Given) -> Result<(), Failure> {
        let back = Stage::Back(sequence, given);
        let mut entries = self.entries.iter_mut();
        match entries.find(|it| it.stage == back) {
            Some(entry) => entry.stage = Stage::Named(given),
            None => {
                let what = format!("{sequence} is released as {given:?}, which it is not");
                return fail(Property::SlotsComeBack, what);
            }
        }
        Ok(())
    }

    /// Records the fate that is reported to the sender. `over` is true if the link has ended.
    //= SM2-MSG-004, SM2-QOS-006 model
    pub(super) fn settled(&mut self, id: u64, fate: Fate, over: bool) -> Result<Entry, Failure> {
        let mut entries = self.entries.iter_mut();
        let found = entries.find(|it| it.id == id && it.fate.is_none());
        let Some(entry) = found else {
            let what = format!("message {id} is settled again");
            return fail(Property::FatesAreTrue, what);
        };
        entry.fate = Some(fate);
        entry.owed = false;
        *self.tally.of_mut(fate) += 1;
        let place = entry.stage;
        let is_true = match fate {
            Fate::Delivered => place == Stage::Named(Given::Consumed),
            Fate::Discarded => place == Stage::Named(Given::Discarded),
            Fate::Overwritten => {
                let told = self.displaced.take();
                entry.stage = Stage::Gone;
                told == Some(id) && place == Stage::Queued
            }
            Fate::Closed => over,
            // No message of the model has another fate: each is shorter than any maximum, and has no lifespan.
            _ => false,
        };
        if is_true {
            return Ok(*entry);
        }
        let early = matches!(fate, Fate::Delivered | Fate::Discarded);
        let property = match place {
            Stage::Named(_) => Property::FatesAreTrue,
            _ if early => Property::SlotsComeBack,
            _ => Property::FatesAreTrue,
        };
        fail(property, format!("{entry:?} is settled"))
    }

    /// The counters that the sender must have.
    pub(super) fn counters(&self) -> Counters {
        Counters {
            in_flight: self.unsettled().count() as u64,
            ..self.tally
        }
    }

    /// The sender's link has ended: messages that its driver keeps are lost.
    pub(super) fn sender_over(&mut self) {
        for entry in &mut self.entries {
            if matches!(entry.stage, Stage::Queued | Stage::Kept(_)) {
                entry.stage = Stage::Gone;
            }
        }
    }

    /// The sender's process has died, so no fate is reported any more.
    pub(super) fn sender_dead(&mut self) {
        self.sender_over();
        for entry in &mut self.entries {
            entry.fate.get_or_insert(Fate::Closed);
        }
    }

    /// The reader's link has ended: ready messages can be taken, and no more arrive.
    pub(super) fn reader_over(&mut self) {
        for entry in &mut self.entries {
            if matches!(entry.stage, Stage::OnTheWire(_) | Stage::Back(..)) {
                entry.stage = Stage::Gone;
            }
        }
    }

    /// The reader's process has died.
    pub(super) fn reader_dead(&mut self) {
        for entry in &mut self.entries {
            if !matches!(
                entry.stage,
                Stage::Queued | Stage::Kept(_) | Stage::Named(_)
            ) {
                entry.stage = Stage::Gone;
            }
        }
    }

    /// Removes the messages that matter to neither end.
    pub(super) fn forget(&mut self) {
        let over = |place| matches!(place, Stage::Gone | Stage::Named(_));
        self.entries
            .retain(|it| it.fate.is_none() || !over(it.stage));
    }
}
