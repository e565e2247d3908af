//! The actions of the applications: publish, call, take, release, close.

use sm2_proto::{
    Farewell,
    link::{Body, Delivery, Fate, Input, Link, NoMemory, OutboundMessage, Payload, Status},
};

use super::{
    super::{Failure, Property},
    Form, LinkScope, World,
    books::{Entry, FlowLimits, Stage},
    fail,
    pool::Slot,
    world::{Life, NOW, Source},
};

/// Every payload is one byte: the id of its message.
const LEN: u64 = 1;

impl World {
    /// Whether end `at` can send a message of this form.
    pub(super) fn has(&self, scope: &LinkScope, at: usize, form: Form) -> bool {
        form != Form::Pooled || self.ends[at].pool.free(scope).is_some()
    }

    /// Publishes, or calls.
    pub(super) fn send(&mut self, scope: &LinkScope, form: Form) -> Result<(), Failure> {
        self.budget.messages -= 1;
        let end = self.end(0);
        end.last += 1;
        let id = end.last;
        if scope.is_service() {
            end.calls.insert(id);
        }
        self.offer(scope, 0, id, form, Status::Ok)
    }

    /// The server's application has finished a call. The reply says so if the call was cancelled.
    /// The third call always misses its deadline.
    pub(super) fn reply(
        &mut self,
        scope: &LinkScope,
        call: u64,
        form: Form,
    ) -> Result<(), Failure> {
        let end = self.end(1);
        end.taken.remove(&call);
        end.calls.remove(&call);
        let status = match call {
            _ if end.cancelled.contains(&call) => Status::Cancelled,
            2 => Status::Failed,
            3 => Status::DeadlinePassed,
            _ => Status::Ok,
        };
        let form = match status.has_payload() {
            true => form,
            false => Form::Inline,
        };
        self.offer(scope, 1, call, form, status)
    }

    fn offer(
        &mut self,
        scope: &LinkScope,
        at: usize,
        id: u64,
        form: Form,
        status: Status,
    ) -> Result<(), Failure> {
        let room = self.room(scope, at);
        let pool = &mut self.end(at).pool;
        let slot = pool.free(scope).filter(|_| form == Form::Pooled);
        if let Some(slot) = slot {
            pool.write(slot, id);
        }
        let has_payload = status.has_payload();
        let body = match (form, slot) {
            (Form::Pooled, Some(Slot { segment, slot, .. })) => Body::Pooled {
                segment: pool.info(scope, segment),
                slot,
            },
            (Form::Sealed, _) => Body::Sealed,
            _ if has_payload => Body::Inline(vec![id as u8].into()),
            _ => Body::Inline(Vec::new().into()),
        };
        let entry = Entry {
            id,
            form,
            slot,
            status,
            stage: Stage::Queued,
            fate: None,
            owed: false,
        };
        self.flows[at].offered(entry, room);
        let message = OutboundMessage {
            key: id,
            id,
            time: NOW,
            status,
            len: if has_payload { LEN } else { 0 },
            body,
        };
        let sent = (self.end(at).link).send(&NoMemory, message, |_, _| {});
        self.called(scope, at, sent.map(drop))?;
        match self.flows[at].displaced.take() {
            None => Ok(()),
            Some(left) => fail(
                Property::MessagesInOrder,
                format!("message {left} is to be displaced"),
            ),
        }
    }

    /// A deadline passes.
    pub(super) fn skip(&mut self, scope: &LinkScope) -> Result<(), Failure> {
        self.budget.skips -= 1;
        self.flows[0].skipped();
        self.feed(scope, 0, Input::Drop(Fate::NoRoom))
    }

    pub(super) fn take(&mut self, scope: &LinkScope, at: usize) -> Result<(), Failure> {
        let limits = FlowLimits::new(scope, 1 - at);
        let Ok(Some(delivery)) = self.end(at).link.take(&NoMemory) else {
            return fail(Property::MessagesInOrder, "there is nothing to take");
        };
        let entry = self.flows[1 - at].taken(&delivery, &limits)?;
        let source = self.locate(at, &entry, &delivery)?;
        self.check_content(at, entry.id, source)?;
        let end = self.end(at);
        end.held.insert(delivery.sequence, source);
        if scope.is_service() && at == 1 && end.over.is_none() {
            end.taken.insert(entry.id);
        }
        self.drain(scope, at, None)
    }

    //= SM2-PAY-002, SM2-PAY-003, SM2-PAY-004 model
    fn locate(&mut self, at: usize, entry: &Entry, delivery: &Delivery) -> Result<Source, Failure> {
        let end = self.end(at);
        let source = match &delivery.payload {
            Payload::Inline(bytes) if !entry.status.has_payload() && bytes.is_empty() => {
                Some(Source::Nothing)
            }
            Payload::Inline(bytes) => bytes.first().map(|it| Source::Copy(u64::from(*it))),
            Payload::Pooled { segment, offset } => {
                let info = end.mapped.get(segment);
                info.and_then(|it| Slot::at(it, *offset)).map(Source::Slot)
            }
            Payload::Sealed => end.files.remove(&delivery.sequence).map(Source::Copy),
            // No end offers a ring.
            Payload::Cell(_) => None,
        };
        match source {
            Some(source) => Ok(source),
            None => fail(
                Property::SlotsComeBack,
                format!("there is no payload to {delivery:?}"),
            ),
        }
    }

    /// Checks that the content of a held message is the sent one.
    //= SM2-PAY-005, SM2-OPN-007, SM2-OPN-010 model
    fn check_content(&self, at: usize, id: u64, source: Source) -> Result<(), Failure> {
        let (found, property) = match source {
            Source::Nothing => return Ok(()),
            Source::Copy(content) => (Some(content), Property::MessagesInOrder),
            Source::Slot(slot) => (self.ends[1 - at].pool.read(slot), Property::SlotsComeBack),
        };
        match found == Some(id) {
            true => Ok(()),
            false => fail(property, format!("message {id} reads {found:?}")),
        }
    }

    pub(super) fn give_back(
        &mut self,
        scope: &LinkScope,
        at: usize,
        sequence: u64,
    ) -> Result<(), Failure> {
        let mut entries = self.flows[1 - at].entries.iter();
        let entry = entries.find(|it| it.stage == Stage::Held(sequence));
        let id = entry.map_or(0, |it| it.id);
        if let Some(source) = self.end(at).held.remove(&sequence) {
            self.check_content(at, id, source)?;
        }
        let over = self.ends[at].over.is_some();
        self.flows[1 - at].given_back(sequence, over);
        let released = self.end(at).link.release(&NoMemory, sequence);
        self.called(scope, at, released.map(drop))
    }

    pub(super) fn cancel(&mut self, scope: &LinkScope, call: u64) -> Result<(), Failure> {
        self.budget.cancels -= 1;
        self.end(0).cancelled.insert(call);
        self.feed(scope, 0, Input::Cancel { call })
    }

    /// The server is told that the caller no longer wants a reply.
    //= SM2-SRV-003 model
    pub(super) fn told_of_cancel(&mut self, at: usize, call: u64) -> Result<(), Failure> {
        let asked = self.ends[1 - at].cancelled.contains(&call);
        let end = self.end(at);
        if asked && end.calls.contains(&call) && end.cancelled.insert(call) {
            return Ok(());
        }
        let what = format!("call {call} is cancelled, asked for: {asked}");
        fail(Property::CallsEndOnce, what)
    }

    pub(super) fn retire(
        &mut self,
        scope: &LinkScope,
        at: usize,
        segment: u32,
    ) -> Result<(), Failure> {
        self.budget.retires -= 1;
        self.end(at).pool.retire(segment);
        self.feed(scope, at, Input::Retire { segment })
    }

    pub(super) fn close(&mut self, scope: &LinkScope, at: usize) -> Result<(), Failure> {
        self.budget.closes -= 1;
        self.end(at).closed = true;
        self.feed(scope, at, Input::Close(Farewell::Done.code()))
    }

    /// Ends a process. Its sent frames can still be read, and its memory does not change.
    pub(super) fn die(&mut self, scope: &LinkScope, at: usize) {
        self.budget.deaths -= 1;
        let end = self.end(at);
        end.life = Life::Dead;
        // No outputs of the dead process are read any more.
        end.link = Link::new(scope.config(at));
        end.kept = None;
        end.mapped.clear();
        end.files.clear();
        end.held.clear();
        end.calls.clear();
        end.taken.clear();
        self.flows[at].sender_dead();
        self.flows[1 - at].reader_dead();
        self.close_socket(scope, at);
    }
}
