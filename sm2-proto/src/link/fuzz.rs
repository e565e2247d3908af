//! Runs one end of a link with operations and frames that are read from fuzz input: the body of the
//! fuzz target `link_frames` and of unit tests. The module `ring` is the body of `ring_words`,
//! where the words of a ring also have values from fuzz input.
//!
//! Most frames are legal except for the parts that the input changes, so that a run gets past the
//! first check. The assertions of [`World`] must hold for any input.

mod ring;
mod world;

use alloc::{vec, vec::Vec};

use bytes::Bytes;

pub(crate) use self::ring::words;
use self::world::World;
use super::{
    Body, Carrier, Fate, Input, LaneKind, NoDelivery, NoMemory, OutboundMessage, Publications,
    Role, SegmentInfo, Status,
    wire::{Form, Frame, Given, LANE_RING, LANE_SOCKET, MessageFrame, Open},
};
use crate::{Code, Datagram, FdFacts, Instant, LinkId, Machine, Seals, fuzz::Script};

const LINK: LinkId = LinkId {
    epoch: 1,
    serial: 2,
};
const NOW: Instant = Instant(0);
/// The size of a slot, and usually of the file of a sealed message.
const STRIDE: u64 = 4_096;

/// Runs the steps that the bytes encode. Panics if the machine broke its contract.
//= SM2-WIR-001, SM2-QOS-006 fuzz
pub(crate) fn frames(data: &[u8]) {
    check_round_trip(data, &[]);
    check_round_trip(data, &[FdFacts::default()]);
    let mut script = Script::new(data);
    let Some(mut world) = World::new(&mut script) else {
        return;
    };
    while world.step(&mut script).is_some() {}
    world.input(Input::Eof);
    assert!(world.link.end().is_some() && world.pending.is_empty());
}

/// Checks that a datagram that is a frame encodes to itself.
fn check_round_trip(bytes: &[u8], fds: &[FdFacts]) {
    if let Ok(frame) = Frame::decode(&Datagram {
        bytes,
        fds,
        ..Datagram::default()
    }) && frame.check_length().is_ok()
    {
        assert_eq!(frame.to_vec(), bytes);
    }
}

impl World {
    fn step(&mut self, script: &mut Script<'_>) -> Option<()> {
        match script.byte()? % 20 {
            0 => {
                let bytes = script.bytes()?;
                self.datagram(bytes, &[]);
            }
            1 | 2 => self.peer_open(script)?,
            3 => self.peer_attach(script)?,
            4 => self.frame(
                &Frame::Detach {
                    segment: script.below(4)? as u32,
                },
                &[],
            ),
            5..=7 => self.peer_message(script)?,
            8 => self.peer_release(script)?,
            9 => {
                let call = self.call(script)?;
                self.frame(&Frame::Cancel { call }, &[]);
            }
            10..=12 => self.send(script)?,
            13 | 14 => self.take(),
            15 => {
                let held = self.held.iter().nth(script.below(4)?).copied();
                let sequence = script.near(held.unwrap_or(1))?;
                self.held.remove(&sequence);
                self.release(sequence);
            }
            16 => self.input(Input::Blocked),
            17 => self.input(Input::Writable),
            18 => self.wish(script)?,
            _ if script.rarely()? => self.end(script)?,
            _ => self.peer_ring(script)?,
        }
        Some(())
    }

    fn peer_open(&mut self, script: &mut Script<'_>) -> Option<()> {
        let config = *self.link.config();
        let lanes = LANE_SOCKET | if config.ring { LANE_RING } else { 0 };
        let window = if config.role == Role::Receiver {
            0
        } else {
            1 + script.below(6)? as u64
        };
        let role = script.near(config.role.counterpart() as u64)? as u8;
        let is_receiver = config.role == Role::Receiver;
        let version = script.near(1)? as u16;
        let window = script.near(window)? as u32;
        self.frame(
            &Frame::Open(Open {
                role,
                version,
                window,
                link: LINK,
                lanes: script.near(u64::from(lanes))? as u32,
                max_len: window,
                publications: Publications {
                    publisher: u64::from(is_receiver),
                    published: if is_receiver { window.into() } else { 0 },
                },
            }),
            &[],
        );
        Some(())
    }

    /// Sends ALIVE or frames of the ring lane, usually on a link of the socket lane, or feeds `Input::Attach`.
    fn peer_ring(&mut self, script: &mut Script<'_>) -> Option<()> {
        let segment = script.below(4)? as u32;
        match script.byte()? % 5 {
            0 => {
                let (depth, window) = (script.near(2)? as u16, 1 + script.below(6)? as u32);
                let facts = FdFacts {
                    regular: !script.rarely()?,
                    size_bytes: script.near(STRIDE)?,
                    seals: Seals(script.near(u64::from(Seals::RING.0))? as u32),
                };
                self.frame(&Frame::Ring { depth, window }, &[facts]);
            }
            1 => self.frame(&Frame::Doorbell, &[]),
            2 => self.frame(&Frame::Detached { segment }, &[]),
            3 => {
                let time = Instant(u64::from(script.byte()?));
                self.frame(&Frame::Alive { time }, &[]);
            }
            _ => self.input(Input::Attach(SegmentInfo {
                id: segment,
                stride: STRIDE,
                slots: 2,
            })),
        }
        Some(())
    }

    fn peer_attach(&mut self, script: &mut Script<'_>) -> Option<()> {
        let (id, stride, slots) = (
            script.below(4)? as u32,
            script.near(STRIDE)?,
            script.near(2)?,
        );
        let facts = FdFacts {
            regular: !script.rarely()?,
            size_bytes: script.near(stride.wrapping_mul(slots))?,
            seals: Seals(script.near(u64::from(Seals::POOLED.0))? as u32),
        };
        self.frame(
            &Frame::Attach(SegmentInfo {
                id,
                stride,
                slots: slots as u32,
            }),
            &[facts],
        );
        Some(())
    }

    fn peer_message(&mut self, script: &mut Script<'_>) -> Option<()> {
        let carrier = match script.byte()? {
            0xff => Carrier::Data,
            0xfe => Carrier::Reply,
            _ => match self.link.config().role {
                Role::Sender | Role::Receiver => Carrier::Data,
                Role::Caller => Carrier::Reply,
                Role::Server => Carrier::Request,
            },
        };
        let is_reply = carrier == Carrier::Reply;
        let sequence = script.near(self.peer.0.saturating_add(1))?;
        let id = if is_reply {
            self.call(script)?
        } else {
            self.peer.1.saturating_add(1 + script.below(3)? as u64)
        };
        let status = if is_reply {
            Status::ALL[script.below(4)?]
        } else {
            Status::Ok
        };
        let rest = if status.has_payload() {
            vec![7; script.below(5)?]
        } else {
            vec![]
        };
        let (form, rest, fits) = match script.byte()? % 3 {
            0 => (Form::Inline, &rest[..], rest.len() as u64),
            1 => {
                let (segment, slot) = (script.below(4)? as u32, script.below(3)? as u32);
                (Form::Pooled { segment, slot }, &[][..], STRIDE)
            }
            _ => (Form::Sealed, &[][..], STRIDE),
        };
        let len = script.near(fits)?;
        let facts = FdFacts {
            regular: true,
            size_bytes: script.near(STRIDE)?,
            seals: Seals(script.near(u64::from(Seals::SEALED.0))? as u32),
        };
        let time = Instant(9);
        let frame = Frame::Message(MessageFrame {
            carrier,
            form,
            status,
            sequence,
            id,
            time,
            len,
            rest,
        });
        self.frame(&frame, &[facts][..frame.fds()]);
        if self.link.end().is_none() {
            self.peer = (sequence, id.max(self.peer.1));
            if carrier == Carrier::Request {
                self.calls.push(id);
            }
        }
        Some(())
    }

    fn peer_release(&mut self, script: &mut Script<'_>) -> Option<()> {
        let count = 1 + script.below(3)?;
        let named: Vec<u64> = self.sent.iter().copied().take(count).collect();
        let named = named.into_iter().map(|sequence| script.near(sequence));
        let named: Vec<u64> = named.collect::<Option<_>>()?;
        let rest: Vec<u8> = named
            .iter()
            .flat_map(|sequence| sequence.to_le_bytes())
            .collect();
        let given = match script.byte()? % 4 {
            0 | 1 => Given::Consumed,
            2 => Given::Discarded,
            _ => Given::Expired,
        };
        self.frame(
            &Frame::Release {
                given,
                count: named.len() as u16,
                rest: &rest,
            },
            &[],
        );
        for sequence in named {
            self.sent.remove(&sequence);
        }
        Some(())
    }

    fn send(&mut self, script: &mut Script<'_>) -> Option<()> {
        self.own += 1;
        let role = self.link.config().role;
        let id = if role == Role::Server {
            self.call(script)?
        } else {
            script.near(self.own)?
        };
        let status = if role == Role::Server && script.byte()? % 4 == 3 {
            Status::Cancelled
        } else {
            Status::Ok
        };
        let content = if status.has_payload() {
            script.at_most(3)
        } else {
            &[]
        };
        let body = match script.byte()? % 3 {
            0 => Body::Inline(Bytes::copy_from_slice(content)),
            1 => {
                let (id, stride, slots) = (script.below(4)? as u32, script.near(STRIDE)?, 2);
                let segment = SegmentInfo { id, stride, slots };
                Body::Pooled {
                    segment,
                    slot: script.below(3)? as u32,
                }
            }
            _ => Body::Sealed,
        };
        let len = script.near(content.len() as u64)?;
        let key = self.own;
        self.pending.insert(key);
        let message = OutboundMessage {
            key,
            id,
            time: NOW,
            status,
            len,
            body,
        };
        let before = self.link.clone();
        let sent = self.link.send(&NoMemory, message, |_, _| {});
        self.check(&before, sent.map(drop));
        if sent.is_err() {
            self.pending.remove(&key);
        } else if role == Role::Caller {
            self.calls.push(id);
        }
        self.drain();
        Some(())
    }

    fn take(&mut self) {
        let limit = usize::from(self.link.config().max_borrowed);
        match self.link.take(&NoMemory) {
            Ok(Some(delivery)) => {
                self.check_delivery(&delivery);
                assert!(self.held.insert(delivery.sequence));
                assert!(self.held.len() <= limit);
            }
            Ok(None) => assert_eq!(self.link.untaken(&NoMemory), 0),
            Err(NoDelivery::Misuse(_)) => {
                let receives = self.link.config().role.receives();
                // This driver lends no ring.
                assert!(!receives || self.link.lane() == LaneKind::Ring);
            }
            Err(_) => assert!(self.held.len() == limit && self.link.untaken(&NoMemory) > 0),
        }
        self.drain();
    }

    fn release(&mut self, sequence: u64) {
        let before = self.link.clone();
        let released = self.link.release(&NoMemory, sequence);
        self.check(&before, released.map(drop));
        self.drain();
    }

    fn wish(&mut self, script: &mut Script<'_>) -> Option<()> {
        match script.byte()? % 5 {
            0 => self.input(Input::Drop(Fate::NoRoom)),
            1 => self.tick(script)?,
            2 => {
                let call = self.call(script)?;
                self.input(Input::Cancel { call });
            }
            3 => self.input(Input::Assert(Instant(u64::from(script.byte()?)))),
            _ => self.input(Input::Retire {
                segment: script.below(4)? as u32,
            }),
        }
        Some(())
    }

    /// Ticks the deadline and the lease at any time. Only a receiver that has one counts.
    fn tick(&mut self, script: &mut Script<'_>) -> Option<()> {
        let now = Instant(u64::from(script.byte()?));
        let before = self.link.watch().missed_deadlines();
        let newest = self.link.newest(&NoMemory);
        let _ = self.link.handle(now, Input::Tick(newest));
        let after = self.link.watch().missed_deadlines();
        let is_receiver = self.link.config().role == Role::Receiver;
        assert!(after >= before && (after == before || is_receiver));
        let watch = self.link.watch();
        assert!(watch.is_alive() || (is_receiver && watch.lost_liveliness() > 0));
        self.drain();
        assert!(self.link.deadline().is_none_or(|due| due > now));
        Some(())
    }

    fn end(&mut self, script: &mut Script<'_>) -> Option<()> {
        let code = Code(u16::from(script.byte()?));
        match script.byte()? % 3 {
            0 => self.input(Input::Close(code)),
            1 => self.frame(&Frame::Close(code), &[]),
            _ => self.input(Input::Eof),
        }
        Some(())
    }

    /// Picks one of the last calls, or an id near it.
    fn call(&self, script: &mut Script<'_>) -> Option<u64> {
        let back = script.below(4)?;
        let call = self.calls.iter().rev().nth(back).copied();
        script.near(call.unwrap_or(1))
    }

    fn frame(&mut self, frame: &Frame<'_>, fds: &[FdFacts]) {
        let bytes = frame.to_vec();
        check_round_trip(&bytes, fds);
        self.datagram(&bytes, fds);
    }
}

#[cfg(test)]
mod tests {
    use super::{frames, words};
    use alloc::vec::Vec;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2_000, ..ProptestConfig::default() })]

        #[test]
        fn bytes_decide(data: Vec<u8>) {
            frames(&data);
        }

        /// Without the bytes that change the most, so that runs get long.
        #[test]
        fn bytes_of_common_operations_decide(data in prop::collection::vec(0_u8..0xfc, 0..600)) {
            frames(&data);
        }

        /// Runs [`words`] with any bytes.
        #[test]
        fn words_are_what_bytes_decide(data in prop::collection::vec(any::<u8>(), 0..400)) {
            words(&data);
        }

        #[test]
        fn words_are_mostly_right(data in prop::collection::vec(0_u8..0xf0, 0..900)) {
            words(&data);
        }
    }
}
