//! A session with a hostile peer and a driver that issues commands.
//!
//! Most inputs are legal, and the bytes change some of them, so that a run gets past the first check.
//! After each input, the outputs of the session are those of the [`Oracle`].

use alloc::{
    collections::{BTreeMap, BTreeSet},
    vec,
    vec::Vec,
};
use core::time::Duration;

use super::{
    super::{
        AskId, Frame, FrameReader, GatewayId, Header, HeaderKind, Hop, OfferId, Outcome,
        PeerFarewell, StreamToken, Subject, SubjectKind, Verdict,
        session::{
            Command, ControlCommand, End, Error, Input, Output, PeerEvent, PeerSession, Transport,
        },
    },
    oracle::Oracle,
};
use crate::{Code, Instant, Machine, Name, TypeId, fuzz::script::Script};

const GREETING: Duration = Duration::from_secs(2);
const LEAST_EPOCH: u64 = 70;

const fn hop(gateway: u8) -> Hop {
    Hop {
        gateway: GatewayId([gateway; 32]),
        epoch: LEAST_EPOCH + gateway as u64,
    }
}

/// A session gives the outputs that SPEC demands, settles each call once, and gives no output after its
/// end.
//= SM2-GWF-001, SM2-GWO-001, SM2-GWO-002, SM2-GWO-003, SM2-GWO-006, SM2-GWM-001, SM2-GWS-001, SM2-GWS-002 fuzz
pub(crate) fn session(data: &[u8]) {
    let Ok(name) = Name::new("me") else {
        return;
    };
    let (me, peer) = (hop(1), hop(2).gateway);
    let mut world = World {
        script: Script::new(data),
        session: PeerSession::new(Instant(0), me, name, peer, LEAST_EPOCH),
        oracle: Oracle::new(me, peer, LEAST_EPOCH),
        reader: FrameReader::default(),
        in_flight: Vec::new(),
        now: Instant(0),
        calls: BTreeSet::new(),
    };
    let hello = world.session.poll();
    assert!(matches!(hello, Some(Output::Transmit(_))), "{hello:?}");
    while world.session.end().is_none() && world.step().is_some() {}
    world.check_end();
}

struct World<'a> {
    script: Script<'a>,
    session: PeerSession,
    oracle: Oracle,
    /// Splits the control stream into frames for the oracle.
    reader: FrameReader,
    /// Bytes of the control stream that the session has not received yet.
    in_flight: Vec<u8>,
    now: Instant,
    /// The streams of calls that are not settled, according to the inputs and outputs of the session.
    calls: BTreeSet<StreamToken>,
}

impl World<'_> {
    /// Runs one operation. `None` when the bytes are used up.
    fn step(&mut self) -> Option<()> {
        match self.script.byte()? % 16 {
            0 => {
                if self.script.rarely()? {
                    let bytes = self.script.bytes()?;
                    self.in_flight.extend(bytes);
                }
                self.control(usize::MAX);
            }
            1..=5 => {
                let frame = self.frame()?;
                self.in_flight.extend(frame.to_bytes());
                // Some frames arrive in pieces, or several at once.
                let len = match self.script.byte()? {
                    0xf0.. => 0,
                    it @ 0xe0.. => usize::from(it - 0xdf),
                    _ => usize::MAX,
                };
                self.control(len);
            }
            6..=10 => {
                let command = self.wish()?;
                self.command(command);
            }
            11..=14 => self.stream()?,
            _ => self.moment()?,
        }
        Some(())
    }

    /// A frame of the peer with a legal encoding.
    fn frame(&mut self) -> Option<Frame> {
        let script = &mut self.script;
        let choice = script.byte()?;
        let is_hello = self.oracle.greeted.is_none() && choice < 0xf0;
        if is_hello || choice == u8::MAX {
            return Some(Frame::Hello {
                min_version: script.near(1)? as u16,
                max_version: script.near(1)? as u16,
                epoch: script.near(hop(2).epoch)?,
                name: script.name()?,
            });
        }
        // An offer that the tables of SPEC allow this frame for, if there is one.
        let oracle = &self.oracle;
        let offer = match choice % 8 {
            2 => pick(script, oracle.known.keys().copied())?,
            3 => pick(script, oracle.withdrawn.iter().copied())?,
            4 => {
                let is_free = |it: &OfferId| !oracle.wanted.contains(it);
                pick(script, oracle.offered.keys().copied().filter(is_free))?
            }
            5 => pick(script, oracle.wanted.union(&oracle.withdrawn).copied())?,
            6 => {
                let ends = oracle.said.iter().filter(|(_, wants)| !**wants);
                pick(script, ends.map(|(offer, _)| *offer))?
            }
            _ => None,
        };
        let offer = match (choice, offer) {
            (0xf0.., None) => Some(OfferId(script.number()?)),
            (_, offer) => offer,
        };
        Some(match (choice % 8, offer) {
            (2, Some(offer)) => Frame::Unoffer { offer },
            (3, Some(offer)) => Frame::Unoffered { offer },
            (4, Some(offer)) => Frame::Want {
                offer,
                depth: 1 + u16::from(script.byte()?),
            },
            (5, Some(offer)) => Frame::Unwant { offer },
            (6, Some(offer)) => Frame::Unwanted { offer },
            (7, _) if script.byte()? % 2 == 0 || oracle.asked.is_empty() => Frame::Ask {
                ask: AskId(script.number()?),
                kind: kind(script)?,
                name: script.name()?,
            },
            (7, _) => Frame::Answer {
                ask: AskId(script.near(oracle.asked.front().map_or(1, |it| it.0))?),
                verdict: verdict(script)?,
            },
            _ => Frame::Offer {
                offer: OfferId(script.near(oracle.last_known.0.saturating_add(1))?),
                subject: subject(script)?,
                path: path(script, &[3, 2])?,
            },
        })
    }

    /// A command of the driver, mostly a legal one.
    fn wish(&mut self) -> Option<Command> {
        let script = &mut self.script;
        Some(match script.byte()? % 9 {
            choice @ 1..=6 => Command::Control(self.control_wish(choice)?),
            0 => Command::Offer {
                offer: OfferId(script.near(self.oracle.last_offered.0.saturating_add(1))?),
                subject: subject(script)?,
                path: path(script, &[3, 1])?,
            },
            7 => Command::Call {
                stream: StreamToken(script.number()?),
                offer: key(script, &self.oracle.said)?,
            },
            _ => Command::Forget {
                stream: key(script, &self.oracle.calls)?,
            },
        })
    }

    fn control_wish(&mut self, choice: u8) -> Option<ControlCommand> {
        let script = &mut self.script;
        Some(match choice {
            1 => ControlCommand::Unoffer {
                offer: key(script, &self.oracle.offered)?,
            },
            2 | 3 => ControlCommand::Want {
                offer: key(script, &self.oracle.known)?,
                depth: script.near(4)? as u16,
            },
            4 => ControlCommand::Unwant {
                offer: key(script, &self.oracle.wishes)?,
            },
            5 => ControlCommand::Ask {
                ask: AskId(script.number()?),
                kind: kind(script)?,
                name: script.name()?,
            },
            _ => ControlCommand::Answer {
                ask: AskId(script.near(self.oracle.owed.front().map_or(1, |it| it.0))?),
                verdict: verdict(script)?,
            },
        })
    }

    /// Feeds the header of a message, a request or a reply.
    fn stream(&mut self) -> Option<()> {
        let (script, oracle) = (&mut self.script, &self.oracle);
        let choice = script.byte()?;
        let is_topic = |it: &OfferId| oracle.known.get(it) != Some(&SubjectKind::Service);
        let is_service = |it: &(&OfferId, &SubjectKind)| *it.1 == SubjectKind::Service;
        let other = StreamToken(8);
        let found = match choice % 4 {
            0 | 1 => {
                let offer = pick(script, oracle.wished.iter().copied().filter(is_topic))?;
                offer.map(|offer| (other, offer))
            }
            2 => {
                let services = oracle.offered.iter().filter(is_service);
                let offer = pick(script, services.map(|(offer, _)| *offer))?;
                offer.map(|offer| (other, offer))
            }
            _ => {
                let stream = pick(script, oracle.calls.keys().copied())?;
                let offer = |it: &StreamToken| oracle.calls.get(it).copied();
                stream.map(|it| (it, offer(&it).unwrap_or(OfferId(1))))
            }
        };
        let (stream, offer) = match found {
            None if choice < 0xf0 => return Some(()),
            None if choice % 4 < 3 => (other, OfferId(script.number()?)),
            None => (StreamToken(script.number()?), OfferId(1)),
            Some(found) => found,
        };
        let (offer, kind) = match choice % 4 {
            0 | 1 => {
                let (sequence, age_ns) = (1, 0);
                (offer, HeaderKind::Message { sequence, age_ns })
            }
            2 => (offer, HeaderKind::Request { left_ns: 0 }),
            _ => {
                let status = Outcome::ALL[script.below(6)?];
                let offer = match choice {
                    0xe0.. => script.number()?,
                    _ => script.near(offer.0)?,
                };
                (OfferId(offer), HeaderKind::Reply { status })
            }
        };
        let header = Header {
            kind,
            offer,
            len: 0,
        };
        // One in eight arrives in a datagram.
        let transport = match self.script.below(8)? {
            0 => Transport::Datagram,
            _ => Transport::Stream(stream),
        };
        let expected = match self.oracle.sees(transport, &header) {
            Ok(output) => vec![output],
            Err(violation) => self.over(End::Violation(violation)),
        };
        let is_reply = matches!(kind, HeaderKind::Reply { .. });
        let event = PeerEvent::Header { transport, header };
        self.feed(Input::Event(event), &expected);
        if is_reply && self.session.end().is_none() {
            assert!(self.calls.remove(&stream), "{stream:?} waited");
        }
        Some(())
    }

    /// Lets time pass, or ends the connection.
    fn moment(&mut self) -> Option<()> {
        let code = Code(self.script.byte()?.into());
        let (input, end) = match self.script.byte()? {
            0xff => (Input::Close(code), Some(End::Local(code))),
            0xfe => (
                Input::Event(PeerEvent::Closed(Some(code))),
                Some(End::Closed(Some(code))),
            ),
            0xfd => (
                Input::Event(PeerEvent::Closed(None)),
                Some(End::Closed(None)),
            ),
            ms => {
                self.now = self.now.after(Duration::from_millis(ms.into()));
                let is_late =
                    self.oracle.greeted.is_none() && self.now >= Instant(0).after(GREETING);
                let late = End::Local(PeerFarewell::GreetingTimeout.code());
                (Input::Tick, is_late.then_some(late))
            }
        };
        let expected = end.map_or(vec![], |end| self.over(end));
        self.feed(input, &expected);
        Some(())
    }

    /// Feeds up to `len` of the bytes that are in flight.
    fn control(&mut self, len: usize) {
        let len = len.min(self.in_flight.len());
        let bytes: Vec<u8> = self.in_flight.drain(..len).collect();
        self.reader.push(&bytes);
        let mut expected = vec![];
        loop {
            let heard = match self.reader.next_frame() {
                Ok(None) => break,
                Ok(Some(frame)) => self.oracle.hears(frame),
                Err(violation) => Err(End::Violation(violation)),
            };
            match heard {
                Ok(outputs) => expected.extend(outputs),
                Err(end) => {
                    expected.extend(self.over(end));
                    break;
                }
            }
        }
        self.feed(Input::Event(PeerEvent::Control(&bytes)), &expected);
    }

    fn command(&mut self, command: Command) {
        if let Some(expected) = self.oracle.asks(&command) {
            if let Command::Call { stream, .. } = command {
                assert!(self.calls.insert(stream), "{stream:?} is free");
            }
            if let Command::Forget { stream } = command {
                assert!(self.calls.remove(&stream), "{stream:?} waited");
            }
            self.feed(Input::Command(command), &expected);
        } else {
            let before = self.session.clone();
            let taken = self
                .session
                .handle(self.now, Input::Command(command.clone()));
            assert!(matches!(taken, Err(Error::Misuse(_))), "{command:?}");
            assert_eq!(self.session, before, "misuse changes nothing");
        }
    }

    /// The outputs of a session that ends.
    fn over(&mut self, end: End) -> Vec<Output> {
        let mut outputs = self.oracle.fail_calls(None);
        outputs.push(Output::Ended(end));
        outputs
    }

    fn feed(&mut self, input: Input<'_>, expected: &[Output]) {
        let taken = self.session.handle(self.now, input.clone());
        let judged = match expected.last() {
            Some(Output::Ended(end @ End::Violation(_))) => Err(Error::Ended(*end)),
            _ => Ok(()),
        };
        assert_eq!(taken, judged, "{input:?}");
        let outputs: Vec<Output> = core::iter::from_fn(|| self.session.poll()).collect();
        assert_eq!(outputs, expected, "{input:?}");
        for output in outputs {
            match output {
                Output::Transmit(bytes) => {
                    let mut reader = FrameReader::default();
                    reader.push(&bytes);
                    assert!(matches!(reader.next_frame(), Ok(Some(_))), "{bytes:02x?}");
                    assert!(reader.is_between_frames());
                }
                Output::CallFailed { stream } => {
                    assert!(self.calls.remove(&stream), "{stream:?} waited");
                }
                Output::Ended(end) => assert_eq!(self.session.end(), Some(end)),
                _ => {}
            }
        }
        let greets = self.oracle.greeted.is_none() && self.session.end().is_none();
        let deadline = greets.then(|| Instant(0).after(GREETING));
        assert_eq!(self.session.deadline(), deadline);
    }

    /// Ends the session. All calls are settled, and every later input is answered with the end.
    fn check_end(&mut self) {
        let code = Code(0);
        if self.session.end().is_none() {
            let expected = self.over(End::Local(code));
            self.feed(Input::Close(code), &expected);
        }
        assert!(self.calls.is_empty(), "{:?} are not settled", self.calls);
        let end = self.session.end().expect("it has ended");
        for input in [
            Input::Event(PeerEvent::Control(&[1])),
            Input::Event(PeerEvent::Closed(None)),
            Input::Close(code),
            Input::Command(Command::Control(ControlCommand::Unoffer {
                offer: OfferId(1),
            })),
            Input::Command(Command::Forget {
                stream: StreamToken(1),
            }),
            Input::Tick,
        ] {
            let answer = self.session.handle(self.now, input);
            assert_eq!(answer, Err(Error::Ended(end)));
        }
        assert_eq!((self.session.poll(), self.session.end()), (None, Some(end)));
    }
}

/// A newtype around `u64`.
trait Id: Copy {
    fn number(self) -> u64;
    fn new(number: u64) -> Self;
}

impl Id for OfferId {
    fn number(self) -> u64 {
        self.0
    }

    fn new(number: u64) -> Self {
        Self(number)
    }
}

impl Id for StreamToken {
    fn number(self) -> u64 {
        self.0
    }

    fn new(number: u64) -> Self {
        Self(number)
    }
}

/// Mostly one of these ids, else one near to it. `Some(None)` if there are no ids.
fn pick<T: Id>(script: &mut Script<'_>, of: impl Iterator<Item = T>) -> Option<Option<T>> {
    let of: Vec<T> = of.collect();
    let Some(last) = of.len().checked_sub(1) else {
        return Some(None);
    };
    let found = of[usize::from(script.byte()?) % (last + 1)];
    script.near(found.number()).map(T::new).map(Some)
}

/// Mostly one of these keys, else another id.
fn key<T: Id, V>(script: &mut Script<'_>, of: &BTreeMap<T, V>) -> Option<T> {
    let found = pick(script, of.keys().copied())?;
    found.map_or_else(|| script.number().map(T::new), Some)
}

fn kind(script: &mut Script<'_>) -> Option<SubjectKind> {
    let kinds = [SubjectKind::Topic, SubjectKind::Service];
    Some(kinds[script.below(2)?])
}

fn verdict(script: &mut Script<'_>) -> Option<Verdict> {
    let verdicts = [Verdict::Offered, Verdict::Denied, Verdict::Absent];
    Some(verdicts[script.below(3)?])
}

fn subject(script: &mut Script<'_>) -> Option<Subject> {
    let name = script.name()?;
    let data = TypeId {
        name: name.clone(),
        hash: 0,
    };
    Some(match kind(script)? {
        SubjectKind::Topic => Subject::Topic {
            name,
            data,
            reliable: true,
            latched: 0,
        },
        SubjectKind::Service => Subject::Service {
            name,
            request: data.clone(),
            reply: data,
        },
    })
}

/// A path through these gateways, or through the last one alone; rarely another path.
fn path(script: &mut Script<'_>, through: &[u8]) -> Option<Vec<Hop>> {
    let choice = script.byte()?;
    let mut path: Vec<Hop> = through.iter().copied().map(hop).collect();
    match choice {
        0xff => path.reverse(),
        0xfe => path.insert(0, hop(1)),
        0xfd => path.insert(0, hop(2)),
        0xfc => path.extend(path.clone()),
        0xfb => path.clear(),
        0xfa => path.splice(0..0, (10..17).map(hop)).for_each(drop),
        0xf9 => {
            let last = path.last_mut()?;
            last.epoch = script.number()?;
        }
        it if it % 2 == 0 => drop(path.drain(..path.len() - 1)),
        _ => {}
    }
    Some(path)
}
