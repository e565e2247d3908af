//! Frames in flight with their descriptors, and the faults that can affect them.

use std::{collections::VecDeque, rc::Rc};

use sm2_proto::{
    Datagram, FdFacts, Seals,
    link::{
        SegmentInfo,
        wire::{Carrier, Frame, Given, MessageFrame, Open},
    },
};

use super::Fault;

/// The frames that one end has sent and the other one has not read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Wire {
    pub(super) queue: VecDeque<Parcel>,
    /// True if the writer has closed, so that the stream ends after the queue.
    pub(super) closed: bool,
}

/// One datagram.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Parcel {
    pub(super) bytes: Rc<[u8]>,
    pub(super) descriptor: Option<Descriptor>,
}

/// The file of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Descriptor {
    Segment(SegmentInfo),
    /// The sealed file with the message of this id.
    File(u64),
}

impl Parcel {
    pub(super) fn facts(&self) -> Option<FdFacts> {
        let (size_bytes, seals) = match self.descriptor? {
            Descriptor::Segment(info) => (info.stride * u64::from(info.slots), Seals::POOLED),
            Descriptor::File(_) => (4096, Seals::SEALED),
        };
        Some(FdFacts {
            regular: true,
            size_bytes,
            seals,
        })
    }

    /// Passes the frame to `see`.
    pub(super) fn with_frame<T>(&self, see: impl FnOnce(Frame<'_>) -> T) -> Option<T> {
        let facts = self.facts();
        let datagram = Datagram {
            fds: facts.as_slice(),
            ..Datagram::new(&self.bytes)
        };
        Frame::decode(&datagram).ok().map(see)
    }

    /// RELEASE of one consumed message.
    pub(super) fn release(sequence: u64) -> Self {
        let frame = Frame::Release {
            given: Given::Consumed,
            count: 1,
            rest: &sequence.to_le_bytes(),
        };
        Self {
            bytes: frame.to_vec().into(),
            descriptor: None,
        }
    }

    /// The same message under another number.
    fn numbered(&self, sequence: u64) -> Option<Self> {
        let changed = |frame: Frame<'_>| match frame {
            Frame::Message(it) => {
                Some(self.changed(&Frame::Message(MessageFrame { sequence, ..it })))
            }
            _ => None,
        };
        self.with_frame(changed).flatten()
    }

    fn changed(&self, frame: &Frame<'_>) -> Self {
        Self {
            bytes: frame.to_vec().into(),
            descriptor: self.descriptor,
        }
    }
}

/// The number and the id of a message.
pub(super) const fn message(frame: &Frame<'_>) -> Option<(u64, u64)> {
    match frame {
        Frame::Message(message) => Some((message.sequence, message.id)),
        _ => None,
    }
}

/// Queues the parcels that arrive for a sent one: the same parcel, unless there is a fault.
pub(super) fn carry(parcel: Parcel, fault: Option<Fault>, queue: &mut VecDeque<Parcel>) {
    let Some(fault) = fault else {
        return queue.push_back(parcel);
    };
    let behind_data = queue.back().is_some_and(is_data) && is_data(&parcel);
    match fault {
        Fault::DataOvertakes if behind_data => queue.insert(queue.len() - 1, parcel),
        Fault::DataReplaces if behind_data => {
            let before = queue.pop_back();
            let sequence = before.and_then(|it| it.with_frame(|frame| message(&frame))?);
            queue.extend(sequence.and_then(|(it, _)| parcel.numbered(it)));
        }
        _ => {
            let tampered = parcel.with_frame(|frame| tamper(&parcel, frame, fault));
            queue.extend(tampered.flatten().unwrap_or_else(|| vec![parcel]));
        }
    }
}

fn is_data(parcel: &Parcel) -> bool {
    let data =
        |frame: Frame<'_>| matches!(frame, Frame::Message(it) if it.carrier == Carrier::Data);
    parcel.with_frame(data) == Some(true)
}

/// Returns the parcels that arrive in place of a frame, or `None` if the fault does not affect it.
fn tamper(parcel: &Parcel, frame: Frame<'_>, fault: Fault) -> Option<Vec<Parcel>> {
    let twice = || vec![parcel.clone(), parcel.clone()];
    match (fault, frame) {
        (Fault::OpenLost, Frame::Open(_))
        | (Fault::AttachLost, Frame::Attach(_))
        | (Fault::DetachLost, Frame::Detach { .. })
        | (Fault::ReleaseLost | Fault::ReleaseEarly, Frame::Release { .. }) => Some(vec![]),
        (Fault::ReleaseTwice, Frame::Release { .. })
        | (Fault::CancelTwice, Frame::Cancel { .. }) => Some(twice()),
        (Fault::OtherWindow, Frame::Open(open)) if open.window > 0 => {
            let window = open.window + 1;
            Some(vec![parcel.changed(&Frame::Open(Open { window, ..open }))])
        }
        (Fault::OtherFate, Frame::Release { given, count, rest }) => {
            let given = match given {
                Given::Consumed => Given::Discarded,
                Given::Discarded | Given::Expired => Given::Consumed,
            };
            Some(vec![parcel.changed(&Frame::Release { given, count, rest })])
        }
        (fault, Frame::Message(message)) => tamper_message(parcel, message, fault),
        _ => None,
    }
}

fn tamper_message(parcel: &Parcel, it: MessageFrame<'_>, fault: Fault) -> Option<Vec<Parcel>> {
    let (sequence, id) = (it.sequence, it.id);
    let numbered =
        |sequence, id| parcel.changed(&Frame::Message(MessageFrame { sequence, id, ..it }));
    match (fault, it.carrier) {
        (Fault::DataLost, Carrier::Data) | (Fault::ReplyLost, Carrier::Reply) => Some(vec![]),
        (Fault::DataAgain, Carrier::Data) => {
            Some(vec![parcel.clone(), numbered(sequence + 1, id + 1)])
        }
        (Fault::OtherCall, Carrier::Reply) if id == 2 => Some(vec![numbered(sequence, 1)]),
        _ => None,
    }
}
