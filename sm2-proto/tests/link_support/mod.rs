//! Helpers of the link tests: frames of a peer, and shorthand for common steps.
#![allow(dead_code, reason = "each test binary uses its part")]

use sm2_proto::{
    Datagram, FdFacts, Instant, LinkId, Machine, Period, Seals, Violation,
    link::{
        Body, Config, End, Error, Fate, Input, Link, LinkMemory, MaxLen, NoMemory, OutboundMessage,
        Output, Packet, Publications, RingLayout, Role, SegmentInfo, Status, Wake,
        wire::{Carrier, Form, Frame, Given, LANE_RING, LANE_SOCKET, MessageFrame, Open},
    },
};

pub(crate) const NOW: Instant = Instant(0);
pub(crate) const LINK: LinkId = LinkId {
    epoch: 7,
    serial: 3,
};
pub(crate) const SEGMENT: SegmentInfo = SegmentInfo {
    id: 5,
    stride: 4096,
    slots: 2,
};

/// Depth 2 with one borrowed message: a window of three.
pub(crate) fn config(role: Role) -> Config {
    Config {
        id: LINK,
        version: 1,
        role,
        reliable: false,
        sealed: false,
        ring: false,
        depth: 2,
        max_borrowed: 1,
        max_len: MaxLen::GREATEST,
        deadline: Period::NONE,
        lifespan: Period::NONE,
        lease: Period::NONE,
        publications: Publications::UNKNOWN,
    }
}

pub(crate) fn reliable(role: Role) -> Config {
    Config {
        reliable: true,
        ..config(role)
    }
}

/// The OPEN that an end with this configuration expects; the other end's window is three.
pub(crate) fn open_to(config: &Config) -> Frame<'static> {
    let window = if config.role == Role::Receiver { 0 } else { 3 };
    open_with(config, window)
}

pub(crate) fn open_with(config: &Config, window: u32) -> Frame<'static> {
    let role = config.role.counterpart() as u8;
    let lanes = LANE_SOCKET | if config.ring { LANE_RING } else { 0 };
    // A sender's OPEN has no maximum.
    let max_len = if config.role == Role::Receiver {
        0
    } else {
        1 << 30
    };
    Frame::Open(Open {
        role,
        version: 1,
        window,
        link: LINK,
        lanes,
        max_len,
        publications: Publications::UNKNOWN,
    })
}

/// A link that has sent and received OPEN, with no output left to poll.
pub(crate) fn opened(config: Config) -> Link {
    opened_with(config, &open_to(&config))
}

pub(crate) fn opened_with(config: Config, open: &Frame<'_>) -> Link {
    let mut link = Link::new(config);
    drain(&mut link);
    accept(&mut link, open);
    link
}

pub(crate) fn drain(link: &mut Link) -> Vec<Output> {
    std::iter::from_fn(|| link.poll()).collect()
}

/// Returns the packets among the outputs.
pub(crate) fn sent(outputs: &[Output]) -> Vec<Packet> {
    let packet = |output: &Output| match output {
        Output::Transmit(packet) => Some(packet.clone()),
        _ => None,
    };
    outputs.iter().filter_map(packet).collect()
}

/// Returns the messages that the outputs settle.
pub(crate) fn settled(outputs: &[Output]) -> Vec<(u64, Fate)> {
    let settled = |output: &Output| match output {
        Output::Settled { key, fate } => Some((*key, *fate)),
        _ => None,
    };
    outputs.iter().filter_map(settled).collect()
}

pub(crate) fn feed(link: &mut Link, bytes: &[u8], fds: &[FdFacts]) -> Result<(), Error> {
    link.handle(
        NOW,
        Input::Datagram(Datagram {
            bytes,
            fds,
            ..Datagram::default()
        }),
    )
}

/// The descriptors that the frame requires, large enough for every test.
pub(crate) fn fds_for(frame: &Frame<'_>) -> Vec<FdFacts> {
    match frame {
        Frame::Ring { depth, window } => {
            let layout = RingLayout::new(*depth, *window);
            vec![ring_file(layout.map_or(4096, RingLayout::size_bytes))]
        }
        Frame::Attach(segment) => vec![pooled(segment.stride * u64::from(segment.slots))],
        Frame::Message(MessageFrame {
            form: Form::Sealed, ..
        }) => vec![sealed(1 << 20)],
        _ => vec![],
    }
}

/// Feeds a frame that the link must accept.
pub(crate) fn accept(link: &mut Link, frame: &Frame<'_>) -> Vec<Output> {
    assert_eq!(
        feed(link, &frame.to_vec(), &fds_for(frame)),
        Ok(()),
        "{frame:?}"
    );
    drain(link)
}

/// Feeds a frame that must end the link. Returns the violation.
pub(crate) fn reject(link: &mut Link, frame: &Frame<'_>) -> Violation {
    match feed(link, &frame.to_vec(), &fds_for(frame)) {
        Err(Error::Ended(End::Violation(violation))) => violation,
        other => panic!("{frame:?}: {other:?}"),
    }
}

pub(crate) fn sealed(size_bytes: u64) -> FdFacts {
    FdFacts {
        regular: true,
        size_bytes,
        seals: Seals::SEALED,
    }
}

pub(crate) fn pooled(size_bytes: u64) -> FdFacts {
    FdFacts {
        regular: true,
        size_bytes,
        seals: Seals::POOLED,
    }
}

pub(crate) fn ring_file(size_bytes: u64) -> FdFacts {
    FdFacts {
        regular: true,
        size_bytes,
        seals: Seals::RING,
    }
}

/// A configuration that offers the ring lane.
pub(crate) fn with_ring(role: Role) -> Config {
    Config {
        ring: true,
        ..config(role)
    }
}

/// The RING frame that a sender in these tests expects.
pub(crate) const RING: Frame<'static> = Frame::Ring {
    depth: 2,
    window: 3,
};

/// A message frame without payload, as a peer sends it.
pub(crate) fn from_peer(carrier: Carrier, sequence: u64, id: u64) -> MessageFrame<'static> {
    MessageFrame {
        carrier,
        form: Form::Inline,
        status: Status::Ok,
        sequence,
        id,
        time: Instant(9),
        len: 0,
        rest: &[],
    }
}

pub(crate) fn data(sequence: u64, id: u64) -> Frame<'static> {
    Frame::Message(from_peer(Carrier::Data, sequence, id))
}

pub(crate) fn data_pooled(sequence: u64, id: u64, slot: u32) -> Frame<'static> {
    let form = Form::Pooled {
        segment: SEGMENT.id,
        slot,
    };
    Frame::Message(MessageFrame {
        form,
        len: 100,
        ..from_peer(Carrier::Data, sequence, id)
    })
}

pub(crate) fn request(sequence: u64, id: u64) -> Frame<'static> {
    Frame::Message(from_peer(Carrier::Request, sequence, id))
}

pub(crate) fn reply(sequence: u64, id: u64) -> Frame<'static> {
    Frame::Message(from_peer(Carrier::Reply, sequence, id))
}

/// The bytes of a RELEASE frame, as a peer sends it.
pub(crate) fn release(given: Given, sequences: &[u64]) -> Vec<u8> {
    let rest: Vec<u8> = sequences.iter().flat_map(|it| it.to_le_bytes()).collect();
    Frame::Release {
        given,
        count: sequences.len() as u16,
        rest: &rest,
    }
    .to_vec()
}

/// Feeds a RELEASE that the link must accept.
pub(crate) fn release_all(link: &mut Link, given: Given, sequences: &[u64]) -> Vec<Output> {
    assert_eq!(feed(link, &release(given, sequences), &[]), Ok(()));
    drain(link)
}

/// An outbound message without payload, with the id as its key.
pub(crate) fn message(id: u64) -> OutboundMessage {
    let body = Body::Inline(bytes::Bytes::new());
    OutboundMessage {
        key: id,
        id,
        time: Instant(9),
        status: Status::Ok,
        len: 0,
        body,
    }
}

pub(crate) fn pooled_message(id: u64, segment: SegmentInfo, slot: u32) -> OutboundMessage {
    OutboundMessage {
        len: 100,
        body: Body::Pooled { segment, slot },
        ..message(id)
    }
}

/// Sends a message on a link of the socket lane.
pub(crate) fn offer(link: &mut Link, message: OutboundMessage) -> Result<(), Error> {
    let sent = link.send(&NoMemory, message, |_, _| panic!("the outputs settle it"));
    sent.map(|wake| assert_eq!(wake, Wake::NotNeeded))
}

/// Sends a message that the link must accept. Returns the outputs.
pub(crate) fn send(link: &mut Link, message: OutboundMessage) -> Vec<Output> {
    assert_eq!(offer(link, message), Ok(()));
    drain(link)
}

/// Releases a message on a link of the socket lane.
pub(crate) fn give_back(link: &mut Link, sequence: u64) -> Result<(), Error> {
    let released = link.release(&NoMemory, sequence);
    released.map(|wake| assert_eq!(wake, Wake::NotNeeded))
}

/// Ticks a link at this time.
pub(crate) fn tick_link(link: &mut Link, now: Instant, memory: &impl LinkMemory) {
    let newest = link.newest(memory);
    let ticked = link.handle(now, Input::Tick(newest));
    assert!(
        matches!(ticked, Ok(()) | Err(Error::Ended(_))),
        "{ticked:?}"
    );
}
