//! The messages for a peer, from the scheduler to their streams.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::{Dir, SendDatagramError, StreamId};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        HEADER_LEN, OfferId, StreamEnd,
        schedule::{DropCause, Input, Next, Output, QueuedMessage, Schedule, SendQos},
    },
};

use super::{
    ahead::{Room, SHORT_BYTES},
    outgoing::{Outgoing, Written},
    outlet::Outlet,
};
use crate::{message::Message, tally::Whose};

/// The stream priority of short messages. Long messages have negative ones, the earlier the
/// greater, so that lost bytes of an earlier message are sent before a later message.
const SHORT_PRIORITY: i32 = 0;

/// A lost message arrives about this many round trips late, because it is sent again.
const RESENT_ROUND_TRIPS: u32 = 2;

/// The messages for one peer.
#[derive(Debug)]
pub(super) struct Topics {
    schedule: Schedule<Message>,
    offers: BTreeMap<OfferId, OfferedTopic>,
    in_flight: BTreeMap<OfferId, InFlight>,
    /// An open stream for the next message that starts.
    stream: Option<StreamId>,
    /// The number of long messages that were started.
    long_started: i32,
    /// No message starts beside others that take more than this.
    sending_max_bytes: u64,
}

/// An offered topic.
#[derive(Debug)]
struct OfferedTopic {
    qos: SendQos,
    is_reliable: bool,
    /// The time of the last publication.
    last_published: Option<Instant>,
    /// True if the next message is published before a lost one could arrive again.
    is_frequent: bool,
}

#[derive(Debug)]
enum InFlight {
    /// No byte of the message has been written yet.
    NotBegun {
        message: Message,
        is_frequent: bool,
    },
    Writing(Outgoing),
}

impl Topics {
    /// No topics. Their messages will occupy at most `max_bytes`.
    pub(super) fn new(max_bytes: u64) -> Self {
        Self {
            schedule: Schedule::new(max_bytes),
            offers: BTreeMap::new(),
            in_flight: BTreeMap::new(),
            stream: None,
            long_started: 0,
            sending_max_bytes: u64::MAX,
        }
    }

    /// Adds a topic that the peer may want. The messages of a reliable one never go as datagrams.
    pub(super) fn add(&mut self, offer: OfferId, qos: SendQos, is_reliable: bool) {
        let added = OfferedTopic {
            qos,
            is_reliable,
            last_published: None,
            is_frequent: false,
        };
        self.offers.insert(offer, added);
    }

    /// Removes a topic, with its messages.
    pub(super) fn remove(&mut self, outlet: &mut Outlet<'_>, offer: OfferId) {
        self.unwanted(outlet, offer);
        self.offers.remove(&offer);
    }

    /// Changes the QoS of a topic, except for the depth, which the peer chooses.
    pub(super) fn change(&mut self, outlet: &mut Outlet<'_>, offer: OfferId, qos: SendQos) {
        if let Some(it) = self.offers.get_mut(&offer) {
            let depth = it.qos.depth;
            it.qos = SendQos { depth, ..qos };
            let qos = it.qos;
            self.schedule(outlet, Input::Change { offer, qos });
        }
    }

    /// The peer wants a topic.
    pub(super) fn wanted(&mut self, outlet: &mut Outlet<'_>, offer: OfferId, depth: u16) {
        if let Some(it) = self.offers.get_mut(&offer) {
            it.qos.depth = depth;
            let qos = it.qos;
            self.schedule(outlet, Input::Open { offer, qos });
        }
    }

    /// The peer no longer wants a topic.
    pub(super) fn unwanted(&mut self, outlet: &mut Outlet<'_>, offer: OfferId) {
        self.schedule(outlet, Input::Close { offer });
    }

    /// Changes how much memory the messages may occupy, and those of them that are started and not acknowledged. Newer
    /// messages displace the oldest.
    pub(super) fn limit(
        &mut self,
        outlet: &mut Outlet<'_>,
        max_bytes: u64,
        sending_max_bytes: u64,
    ) {
        self.sending_max_bytes = sending_max_bytes;
        if self.schedule.max_bytes() != max_bytes {
            self.schedule(outlet, Input::Limit { max_bytes });
        }
    }

    pub(super) fn tick(&mut self, outlet: &mut Outlet<'_>) {
        self.schedule(outlet, Input::Tick);
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.schedule.deadline()
    }

    /// Queues a message, if the peer wants its topic.
    pub(super) fn publish(&mut self, outlet: &mut Outlet<'_>, offer: OfferId, message: Message) {
        let published_at = message.published_at;
        if let Some(it) = self.offers.get_mut(&offer) {
            let resent = outlet.connection.rtt() * RESENT_ROUND_TRIPS;
            let last = it.last_published.replace(published_at);
            it.is_frequent = last.is_some_and(|last| published_at.since(last) < resent);
        }
        let message = QueuedMessage {
            len_bytes: (HEADER_LEN + message.payload.len()) as u64,
            published_at,
            message,
        };
        // Counted before the scheduler's outputs, so that no message counts as dropped before it
        // counts as offered.
        if self.schedule.is_open(offer) {
            outlet.tally.count(Whose::Ours(offer), |it| it.offered += 1);
            self.schedule(outlet, Input::Enqueue { offer, message });
        }
    }

    /// The sum of the lengths of the messages that are started and not written completely.
    pub(super) fn in_flight_bytes(&self) -> u64 {
        self.in_flight.values().map(InFlight::len_bytes).sum()
    }

    /// Whether a message may start beside those that are not acknowledged.
    fn may_start(&self, outlet: &Outlet<'_>, len_bytes: usize) -> bool {
        let sending_bytes = self.in_flight_bytes() + outlet.unacked.bytes();
        sending_bytes == 0 || sending_bytes + len_bytes as u64 <= self.sending_max_bytes
    }

    /// True if there is nothing to write.
    pub(super) fn is_idle(&self) -> bool {
        self.schedule.order().next().is_none()
    }

    /// Writes messages in the order of the scheduler, as far as there is `room`.
    pub(super) fn write(&mut self, outlet: &mut Outlet<'_>, room: &mut Room) {
        while let Some(input) = self.write_first(outlet, room) {
            match input {
                Input::Close { offer } => self.discard(outlet, offer),
                input => self.schedule(outlet, input),
            }
        }
    }

    /// Ends what is being sent of topics that other rules deny.
    //= SM2-GWR-004
    pub(super) fn reset_denied(&mut self, outlet: &mut Outlet<'_>) {
        let in_flight = self.in_flight.keys().copied();
        let denied: Vec<OfferId> = in_flight.filter(|it| outlet.denies(*it)).collect();
        for offer in denied {
            self.discard(outlet, offer);
        }
    }

    /// Drops all messages of a topic. It stays open, because the next rules may allow it again.
    fn discard(&mut self, outlet: &mut Outlet<'_>, offer: OfferId) {
        self.schedule(outlet, Input::Close { offer });
        if let Some(qos) = self.offers.get(&offer).map(|it| it.qos) {
            self.schedule(outlet, Input::Open { offer, qos });
        }
    }

    /// Writes messages until one of them can start, is complete or refused, or is denied. Returns the
    /// scheduler's input.
    fn write_first(&mut self, outlet: &mut Outlet<'_>, room: &mut Room) -> Option<Input<Message>> {
        let mut may_start = true;
        for next in self.schedule.order() {
            let offer = match next {
                Next::Continue { offer } => offer,
                //= SM2-GWR-004
                Next::Start { offer } if outlet.denies(offer) => {
                    return Some(Input::Close { offer });
                }
                // Shorter ones do not overtake it, or it might wait for ever.
                Next::Start { .. } if !may_start => continue,
                Next::Start { offer } => {
                    let len_bytes = self.schedule.next(offer)?.message.payload.len();
                    if room.left(len_bytes) == 0 {
                        return None;
                    }
                    may_start = self.may_start(outlet, len_bytes);
                    if !may_start {
                        continue;
                    }
                    let streams = outlet.connection.streams();
                    self.stream = self.stream.or_else(|| { streams }.open(Dir::Uni));
                    // The peer may allow no more streams at present.
                    if self.stream.is_none() {
                        continue;
                    }
                    return Some(Input::Start { offer });
                }
            };
            let Some(in_flight) = self.in_flight.get_mut(&offer) else {
                continue;
            };
            match in_flight.write(
                offer,
                outlet,
                room,
                (&mut self.stream, &mut self.long_started),
            ) {
                // The peer takes no more bytes of this message, but perhaps of another.
                Written::Part => continue,
                Written::NoRoom => return None,
                Written::All => outlet.tally.count(Whose::Ours(offer), |it| it.sent += 1),
                Written::Stopped => {
                    (outlet.tally).count(Whose::Ours(offer), |it| it.withdrawn += 1)
                }
            }
            self.in_flight.remove(&offer);
            return Some(Input::Sent { offer });
        }
        None
    }

    /// Feeds the scheduler, and carries out its outputs.
    fn schedule(&mut self, outlet: &mut Outlet<'_>, input: Input<Message>) {
        // Misuse is possible: commands of the hub cross events of the peer, so a topic may have
        // been closed in the meantime. Such a command has no effect.
        let _ = self.schedule.handle(outlet.now, input);
        while let Some(output) = self.schedule.poll() {
            self.carry_out(outlet, output);
        }
    }

    fn carry_out(&mut self, outlet: &mut Outlet<'_>, output: Output<Message>) {
        match output {
            Output::Start { offer, message } => {
                let offered = self.offers.get(&offer);
                let is_frequent = offered.is_some_and(|it| it.is_frequent && !it.is_reliable);
                let in_flight = InFlight::NotBegun {
                    message,
                    is_frequent,
                };
                self.in_flight.insert(offer, in_flight);
            }
            Output::Drop { offer, cause, .. } => {
                outlet.tally.count(Whose::Ours(offer), |it| match cause {
                    DropCause::Superseded | DropCause::Displaced => it.superseded += 1,
                    DropCause::Expired => it.expired += 1,
                    DropCause::Withdrawn => it.withdrawn += 1,
                });
            }
            Output::Reset { offer } => {
                outlet
                    .tally
                    .count(Whose::Ours(offer), |it| it.withdrawn += 1);
                if let Some(InFlight::Writing(outgoing)) = self.in_flight.remove(&offer) {
                    outgoing.reset(outlet.connection, StreamEnd::Withdrawn);
                }
            }
        }
    }

    /// The connection is over: drops all messages.
    pub(super) fn end(&mut self, outlet: &mut Outlet<'_>) {
        let offers: Vec<OfferId> = self.offers.keys().copied().collect();
        for offer in offers {
            self.remove(outlet, offer);
        }
    }
}

impl InFlight {
    /// The length of the payload.
    fn len_bytes(&self) -> u64 {
        let len_bytes = match self {
            Self::NotBegun { message, .. } => message.payload.len(),
            Self::Writing(outgoing) => outgoing.len_bytes(),
        };
        len_bytes as u64
    }

    fn write(
        &mut self,
        offer: OfferId,
        outlet: &mut Outlet<'_>,
        room: &mut Room,
        (stream, long_started): (&mut Option<StreamId>, &mut i32),
    ) -> Written {
        if let Self::NotBegun {
            message,
            is_frequent,
        } = self
        {
            if room.left(message.payload.len()) == 0 {
                return Written::NoRoom;
            }
            if *is_frequent && let Some(written) = send_datagram(message, offer, outlet, room) {
                return written;
            }
        }
        self.begin(offer, outlet, stream, long_started);
        let Self::Writing(outgoing) = self else {
            // The peer allows no more streams at present.
            return Written::Part;
        };
        let written = outgoing.write(outlet.connection, room);
        match written {
            Written::All => outlet.unacked.add(outgoing.stream, outgoing.len_bytes()),
            Written::Stopped => outgoing.reset(outlet.connection, StreamEnd::Withdrawn),
            Written::Part | Written::NoRoom => {}
        }
        written
    }

    /// Takes the open stream for a message that has none.
    fn begin(
        &mut self,
        offer: OfferId,
        outlet: &mut Outlet<'_>,
        stream: &mut Option<StreamId>,
        long_started: &mut i32,
    ) {
        let Self::NotBegun { message, .. } = self else {
            return;
        };
        let open = || outlet.connection.streams().open(Dir::Uni);
        let Some(stream) = stream.take().or_else(open) else {
            return;
        };
        let priority = match message.payload.len() {
            ..=SHORT_BYTES => SHORT_PRIORITY,
            _ => {
                *long_started = long_started.saturating_add(1);
                -*long_started
            }
        };
        // Fails only for a stream that is closed, and this one was opened just now.
        let _ = outlet.connection.send_stream(stream).set_priority(priority);
        let header = message.header(offer, outlet.now);
        let outgoing = Outgoing::new(stream, &header, message.payload.clone());
        *self = Self::Writing(outgoing);
    }
}

/// Sends a message as a datagram. Returns `None` if it is too long for one.
//= SM2-GWM-003
fn send_datagram(
    message: &Message,
    offer: OfferId,
    outlet: &mut Outlet<'_>,
    room: &mut Room,
) -> Option<Written> {
    let head = message.header(offer, outlet.now).to_bytes();
    let len_bytes = head.len() + message.payload.len();
    let mut datagrams = outlet.connection.datagrams();
    if datagrams.max_size()? < len_bytes {
        return None;
    }
    let bytes = Bytes::from([&head[..], &message.payload].concat());
    match datagrams.send(bytes, false) {
        Ok(()) => {
            room.take(len_bytes);
            Some(Written::All)
        }
        Err(SendDatagramError::Blocked(_)) => Some(Written::Part),
        Err(_) => None,
    }
}
