//! The drivers: they feed their machines, and carry out the outputs.

use sm2_proto::{
    Datagram, Machine,
    link::{
        Attachment, End as Reason, Error, Fate, Input, Output, Packet, SegmentInfo, wire::Frame,
    },
};

use super::{
    super::{Failure, Property},
    Fault, LinkScope, World,
    books::{FlowLimits, Stage},
    fail,
    wire::{Descriptor, Parcel, carry, message},
    world::NOW,
};

/// The kind of CLOSE.
const CLOSE: u8 = 9;

impl World {
    /// Feeds an end's machine, and carries out all its outputs.
    pub(super) fn feed(
        &mut self,
        scope: &LinkScope,
        at: usize,
        input: Input<'_>,
    ) -> Result<(), Failure> {
        self.handle(at, input)?;
        self.drain(scope, at, None)
    }

    /// Checks the result of a call of the application.
    pub(super) fn called(
        &mut self,
        scope: &LinkScope,
        at: usize,
        result: Result<(), Error>,
    ) -> Result<(), Failure> {
        Self::judge(at, result)?;
        self.drain(scope, at, None)
    }

    fn handle(&mut self, at: usize, input: Input<'_>) -> Result<(), Failure> {
        let result = self.end(at).link.handle(NOW, input);
        Self::judge(at, result)
    }

    fn judge(at: usize, result: Result<(), Error>) -> Result<(), Failure> {
        match result {
            Ok(()) | Err(Error::Ended(_)) => Ok(()),
            Err(Error::Misuse(misuse)) => {
                fail(Property::Invariants, format!("end {at} refuses: {misuse}"))
            }
        }
    }

    /// An end reads its next frame, or the end of the stream.
    pub(super) fn read(&mut self, scope: &LinkScope, at: usize) -> Result<(), Failure> {
        let Some(parcel) = self.wires[1 - at].queue.pop_front() else {
            assert!(scope.fault != Some(Fault::Panics), "a machine panics");
            return self.feed(scope, at, Input::Eof);
        };
        let facts = parcel.facts();
        let datagram = Datagram {
            fds: facts.as_slice(),
            ..Datagram::new(&parcel.bytes)
        };
        self.handle(at, Input::Datagram(datagram))?;
        if self.ends[at].link.end().is_none() {
            let came = parcel.with_frame(|frame| message(&frame)).flatten();
            if let Some(came) = came {
                self.accepted(scope, at, came)?;
            }
        }
        self.drain(scope, at, parcel.descriptor)
    }

    /// The machine of an end has accepted a message.
    fn accepted(&mut self, scope: &LinkScope, at: usize, came: (u64, u64)) -> Result<(), Failure> {
        let limits = FlowLimits::new(scope, 1 - at);
        self.flows[1 - at].accepted(came, &limits)?;
        let (sequence, id) = came;
        if scope.fault == Some(Fault::ReleaseEarly) {
            self.wires[at].queue.push_back(Parcel::release(sequence));
        }
        if limits.data {
            return Ok(());
        }
        let calls = &mut self.end(at).calls;
        let as_it_was = match limits.replies {
            true => calls.remove(&id),
            false => calls.insert(id),
        };
        match as_it_was {
            true => Ok(()),
            false => fail(Property::CallsEndOnce, format!("call {id} comes again")),
        }
    }

    /// Carries out all outputs of a machine. `came` is the descriptor of the datagram just handled.
    pub(super) fn drain(
        &mut self,
        scope: &LinkScope,
        at: usize,
        mut came: Option<Descriptor>,
    ) -> Result<(), Failure> {
        while let Some(output) = self.end(at).link.poll() {
            if self.ends[at].over.is_some() {
                return fail(Property::SilentAfterEnd, format!("end {at}: {output:?}"));
            }
            self.observe(scope, at, output, &mut came)?;
        }
        if let Some(left) = came.filter(|_| self.ends[at].over.is_none()) {
            return fail(Property::SlotsComeBack, format!("nobody keeps {left:?}"));
        }
        match self.flows[1 - at].discarded.take() {
            None => Ok(()),
            Some(left) => fail(
                Property::MessagesInOrder,
                format!("message {left} is to be displaced"),
            ),
        }
    }

    /// Carries out one output; this is the only place that matches outputs.
    fn observe(
        &mut self,
        scope: &LinkScope,
        at: usize,
        output: Output,
        came: &mut Option<Descriptor>,
    ) -> Result<(), Failure> {
        match output {
            Output::Transmit(packet) => self.transmit(scope, at, packet),
            Output::Opened => {
                self.end(at).opened = true;
                Ok(())
            }
            Output::Attach {
                segment,
                stride,
                slots,
            } => {
                let info = SegmentInfo {
                    id: segment,
                    stride,
                    slots,
                };
                self.attach(at, info, came.take())
            }
            Output::Detach { segment } => self.detach(at, segment),
            Output::Keep { sequence } => self.keep(at, sequence, came.take()),
            Output::Discard { sequence } => self.discard(at, sequence),
            Output::Ring(_) => unreachable!("no end offers a ring"),
            Output::Settled { key, fate } => self.settle(scope, at, key, fate),
            Output::Cancelled { call } => self.told_of_cancel(at, call),
            //= SM2-SRV-004 model
            Output::CallFailed { call } => match self.end(at).calls.remove(&call) {
                true => Ok(()),
                false => fail(Property::CallsEndOnce, format!("call {call} fails again")),
            },
            Output::Ended(reason) => self.hang_up(scope, at, reason),
        }
    }

    fn keep(&mut self, at: usize, sequence: u64, came: Option<Descriptor>) -> Result<(), Failure> {
        let Some(Descriptor::File(content)) = came else {
            let what = format!("message {sequence} comes without its file");
            return fail(Property::SlotsComeBack, what);
        };
        self.end(at).files.insert(sequence, content);
        Ok(())
    }

    fn discard(&mut self, at: usize, sequence: u64) -> Result<(), Failure> {
        self.end(at).files.remove(&sequence);
        let told = self.flows[1 - at].discarded.take();
        if told == Some(sequence) {
            return Ok(());
        }
        let what = format!("message {sequence} is displaced, not {told:?}");
        fail(Property::MessagesInOrder, what)
    }

    //= SM2-OPN-010 model
    fn settle(
        &mut self,
        scope: &LinkScope,
        at: usize,
        key: u64,
        fate: Fate,
    ) -> Result<(), Failure> {
        let over = self.ends[at].link.end().is_some();
        let entry = self.flows[at].settled(key, fate, over)?;
        let (end, reused) = (self.end(at), scope.fault == Some(Fault::AbandonedReused));
        match entry.slot {
            Some(slot) if over && !reused => end.pool.abandon(slot),
            Some(slot) => end.pool.give_back(slot),
            None => {}
        }
        Ok(())
    }

    /// Sends a packet that its machine handed out, or keeps it.
    fn transmit(&mut self, scope: &LinkScope, at: usize, packet: Packet) -> Result<(), Failure> {
        let parcel = self.parcel(scope, at, &packet)?;
        let released = parcel.with_frame(|frame| match frame {
            Frame::Release { given, .. } => Some((given, frame.sequences().collect::<Vec<_>>())),
            _ => None,
        });
        if let Some((given, sequences)) = released.flatten() {
            for sequence in sequences {
                self.flows[1 - at].named(sequence, given)?;
            }
        }
        if let Some(leaves) = parcel.with_frame(|frame| message(&frame)).flatten() {
            let (limits, opened) = (FlowLimits::new(scope, at), self.ends[at].opened);
            self.flows[at].handed_out(leaves, &limits, opened)?;
        }
        if self.is_full(scope, at) {
            self.handle(at, Input::Blocked)?;
            self.end(at).kept = Some(packet);
            return Ok(());
        }
        self.put(scope, at, parcel)
    }

    /// The socket accepts packets again.
    pub(super) fn flush(&mut self, scope: &LinkScope, at: usize) -> Result<(), Failure> {
        if let Some(packet) = self.end(at).kept.take() {
            self.handle(at, Input::Writable)?;
            let parcel = self.parcel(scope, at, &packet)?;
            self.put(scope, at, parcel)?;
        }
        self.drain(scope, at, None)
    }

    /// Returns a packet with its descriptor, which its sender must still have.
    fn parcel(&self, scope: &LinkScope, at: usize, packet: &Packet) -> Result<Parcel, Failure> {
        let descriptor = match packet.attachment {
            None => None,
            Some(Attachment::Ring) => unreachable!("no end offers a ring"),
            Some(Attachment::Segment(id)) => {
                Some(Descriptor::Segment(self.ends[at].pool.info(scope, id)))
            }
            Some(Attachment::Message(key)) => {
                let mut entries = self.flows[at].entries.iter();
                if !entries.any(|it| it.id == key && it.fate.is_none()) {
                    let what = format!("the file of message {key} is sent, which is settled");
                    return fail(Property::SlotsComeBack, what);
                }
                Some(Descriptor::File(key))
            }
        };
        Ok(Parcel {
            bytes: packet.to_vec().into(),
            descriptor,
        })
    }

    /// Puts a packet in flight.
    //= SM2-OPN-007, SM2-OPN-009 model
    fn put(&mut self, scope: &LinkScope, at: usize, parcel: Parcel) -> Result<(), Failure> {
        let last = self.wires[at].queue.back();
        if self.ends[at].over.is_some() || last.is_some_and(|it| it.bytes[0] == CLOSE) {
            let what = format!("end {at} sends {:?} after the end", parcel.bytes);
            return fail(Property::SilentAfterEnd, what);
        }
        let lost = self.ends[1 - at].is_gone();
        if let Some((sequence, _)) = parcel.with_frame(|frame| message(&frame)).flatten() {
            let to = match lost {
                true => Stage::Gone,
                false => Stage::OnTheWire(sequence),
            };
            self.flows[at].moved(Stage::Kept(sequence), to);
        }
        if !lost {
            carry(parcel, scope.fault, &mut self.wires[at].queue);
        }
        Ok(())
    }

    fn attach(
        &mut self,
        at: usize,
        info: SegmentInfo,
        came: Option<Descriptor>,
    ) -> Result<(), Failure> {
        let before = self.end(at).mapped.insert(info.id, info);
        if before.is_none() && came == Some(Descriptor::Segment(info)) {
            return Ok(());
        }
        let what = format!("{info:?} is attached with {came:?}, over {before:?}");
        fail(Property::SlotsComeBack, what)
    }

    //= SM2-SEG-005 model
    fn detach(&mut self, at: usize, segment: u32) -> Result<(), Failure> {
        let mapped = self.end(at).mapped.remove(&segment);
        let mut entries = self.flows[1 - at].entries.iter();
        let here = |place| matches!(place, Stage::Ready(_) | Stage::Held(_) | Stage::Back(..));
        let used =
            entries.any(|it| here(it.stage) && it.slot.is_some_and(|it| it.segment == segment));
        if mapped.is_some() && !used {
            return Ok(());
        }
        let what = format!("{segment} is detached, was {mapped:?}, is in use: {used}");
        fail(Property::SlotsComeBack, what)
    }

    /// A link has ended for one end, so its driver closes the socket.
    //= SM2-OPN-007, SM2-OPN-008, SM2-OPN-009, SM2-TRN-005 model
    fn hang_up(&mut self, scope: &LinkScope, at: usize, reason: Reason) -> Result<(), Failure> {
        let other = &self.ends[1 - at];
        let just = match reason {
            Reason::Violation(_) => false,
            Reason::Local(_) => self.ends[at].closed,
            Reason::Peer(code) => other.over == Some(Reason::Local(code)),
            Reason::Eof => other.is_gone(),
        };
        if !just {
            return fail(Property::EndAccusesNobody, format!("end {at}: {reason}"));
        }
        let read_all = matches!(reason, Reason::Peer(_) | Reason::Eof);
        let mut entries = self.flows[1 - at].entries.iter();
        let unread = entries.find(|it| matches!(it.stage, Stage::OnTheWire(_)));
        if let Some(unread) = unread.filter(|_| read_all) {
            let what = format!("{unread:?} was sent before the end");
            return fail(Property::MessagesInOrder, what);
        }
        if scope.is_service() && !self.ends[0].calls.is_empty() && at == 0 {
            return fail(Property::CallsEndOnce, "a call goes on after the link");
        }
        let end = self.end(at);
        end.over = Some(reason);
        end.taken.clear();
        if at == 1 {
            end.calls.clear();
        }
        let kept = end.kept.take();
        self.flows[at].sender_over();
        self.flows[1 - at].reader_over();
        if let Some(packet) = kept.filter(|_| scope.fault == Some(Fault::KeptAfterEnd)) {
            let parcel = self.parcel(scope, at, &packet)?;
            self.put(scope, at, parcel)?;
        }
        self.close_socket(scope, at);
        Ok(())
    }

    /// Closes the socket of an end. Sent frames can still be read; frames that the end has not read
    /// are lost.
    pub(super) fn close_socket(&mut self, scope: &LinkScope, at: usize) {
        self.wires[at].closed = true;
        self.wires[1 - at].queue.clear();
        if scope.fault == Some(Fault::EndOvertakes) {
            self.wires[at].queue.clear();
        }
    }
}
