//! Plain lists of what was sent one way: where each message is, and what must become of it.

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
    /// Whether replies go this way.
    pub(super) replies: bool,
    /// Whether publications do.
    pub(super) data: bool,
    displaces: bool,
    /// How many messages may wait for the window.
    waiting: usize,
    /// How many may be ready, if the next displaces one.
    ready: usize,
    max_borrowed: usize,
    window: usize,
}

impl FlowLimits {
    /// Those of what end `from` sends.
    pub(super) fn new(scope: &LinkScope, from: usize) -> Self {
        let [ours, theirs] = [scope.config(from), scope.config(1 - from)];
        Self {
            replies: scope.service && from == 1,
            data: !scope.service,
            displaces: !scope.service && !scope.reliable,
            waiting: match scope.service {
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

/// Where a message is, on its way and back. The number is its `sequence`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// With the machine that sends it.
    Queued,
    /// With the driver, whose socket is full.
    Kept(u64),
    OnTheWire(u64),
    /// Not taken yet.
    Ready(u64),
    /// The application's.
    Held(u64),
    /// Given back, or displaced before it was taken.
    Back(u64, Given),
    /// A RELEASE has left that names it.
    Named(Given),
    /// It comes no further.
    Gone,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Entry {
    /// Also the driver's key for it, and its content.
    pub(super) id: u64,
    pub(super) form: Form,
    pub(super) slot: Option<Slot>,
    pub(super) status: Status,
    pub(super) stage: Stage,
    /// The fate that its sender knows.
    pub(super) fate: Option<Fate>,
}

/// Whether there is room for one more message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Room {
    Free,
    /// If the oldest one goes that waits.
    Displaces(u64),
    None,
}

/// All messages of one direction that one of both ends still has to do with.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Flow {
    pub(super) entries: VecDeque<Entry>,
    /// Of all that were ever sent this way; `in_flight` is not kept here.
    tally: Counters,
    /// The number of the last one that left its machine.
    sequence: u64,
    /// The id that the reader would see next if none were lost.
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

    /// How many the sender has sent and not got back.
    fn unreleased(&self) -> usize {
        self.unsettled().count() - self.queued().count()
    }

    /// Whether there is room at the sender, which knows the window or not.
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

    /// The application gave its machine a message.
    pub(super) fn offered(&mut self, entry: Entry, room: Room) {
        self.tally.offered += 1;
        if let Room::Displaces(id) = room {
            self.displaced = Some(id);
        }
        self.entries.push_back(entry);
    }

    /// A deadline passed.
    pub(super) fn skipped(&mut self) {
        self.tally.offered += 1;
        self.tally.deadline += 1;
    }

    /// The machine handed out the packet of a message.
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

    /// Where a message is now that was at `from`.
    pub(super) fn moved(&mut self, from: Stage, to: Stage) {
        let mut entries = self.entries.iter_mut();
        if let Some(entry) = entries.find(|it| it.stage == from) {
            entry.stage = to;
        }
    }

    /// The reader's machine has taken a message in.
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

    /// The oldest that was not taken goes back.
    fn displace(&mut self) {
        for entry in &mut self.entries {
            if let Stage::Ready(sequence) = entry.stage {
                entry.stage = Stage::Back(sequence, Given::Discarded);
                self.discarded = Some(sequence);
                return;
            }
        }
    }

    /// How many wait to be taken.
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

    /// Whether the application may take one more.
    pub(super) fn may_take(&self, limits: &FlowLimits) -> bool {
        self.held().count() < limits.max_borrowed
    }

    /// The application took a message: the one that this gives.
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

    /// The application gave a message back, on a link that is `over` or not.
    pub(super) fn given_back(&mut self, sequence: u64, over: bool) {
        let to = match over {
            true => Stage::Gone,
            false => Stage::Back(sequence, Given::Consumed),
        };
        self.moved(Stage::Held(sequence), to);
    }

    /// A RELEASE left that names this message.
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

    /// The sender is told what became of a message; `over` if its link ended.
    //= SM2-MSG-004, SM2-QOS-004 model
    pub(super) fn settled(&mut self, id: u64, fate: Fate, over: bool) -> Result<Entry, Failure> {
        let mut entries = self.entries.iter_mut();
        let found = entries.find(|it| it.id == id && it.fate.is_none());
        let Some(entry) = found else {
            let what = format!("message {id} is settled again");
            return fail(Property::FatesAreTrue, what);
        };
        entry.fate = Some(fate);
        let (tally, place) = (&mut self.tally, entry.stage);
        let is_true = match fate {
            Fate::Delivered => {
                tally.delivered += 1;
                place == Stage::Named(Given::Consumed)
            }
            Fate::Discarded => {
                tally.discarded += 1;
                place == Stage::Named(Given::Discarded)
            }
            Fate::Overwritten => {
                tally.overwritten += 1;
                let told = self.displaced.take();
                entry.stage = Stage::Gone;
                told == Some(id) && place == Stage::Queued
            }
            Fate::Closed => {
                tally.closed += 1;
                over
            }
            Fate::Deadline => false,
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

    /// Counters as the sender must have them.
    pub(super) fn counters(&self) -> Counters {
        Counters {
            in_flight: self.unsettled().count() as u64,
            ..self.tally
        }
    }

    /// The sender's link is over: what its driver has, nobody gets.
    pub(super) fn sender_over(&mut self) {
        for entry in &mut self.entries {
            if matches!(entry.stage, Stage::Queued | Stage::Kept(_)) {
                entry.stage = Stage::Gone;
            }
        }
    }

    /// The sender's process is gone, and nobody asks for fates any more.
    pub(super) fn sender_dead(&mut self) {
        self.sender_over();
        for entry in &mut self.entries {
            entry.fate.get_or_insert(Fate::Closed);
        }
    }

    /// The reader's link is over: what is there can be taken, nothing more comes.
    pub(super) fn reader_over(&mut self) {
        for entry in &mut self.entries {
            if matches!(entry.stage, Stage::OnTheWire(_) | Stage::Back(..)) {
                entry.stage = Stage::Gone;
            }
        }
    }

    /// The reader's process is gone.
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

    /// Forgets what both sides are done with.
    pub(super) fn forget(&mut self) {
        let over = |place| matches!(place, Stage::Gone | Stage::Named(_));
        self.entries
            .retain(|it| it.fate.is_none() || !over(it.stage));
    }
}
