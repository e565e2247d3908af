//! One connection with a peer: who the peer is, what each side offers and wants, and which streams
//! are legal (SPEC sections 14.2 to 14.5).
//!
//! [`PeerSession`] keeps the contract of [`Machine`]. Its first output is the HELLO of this side; its
//! one deadline is the latest time for that of the peer. The bytes of payloads never
//! come here, only the [`Header`] of each stream.
//!
//! | state | what is legal there | leads to |
//! | --- | --- | --- |
//! | greeting | [`Input::Event`], [`Input::Close`], [`Input::Tick`] | HELLO: open. 2 s without HELLO: ended |
//! | open | every input | a violation, [`PeerEvent::Closed`], [`Input::Close`]: ended |
//! | ended | nothing: each input is answered with the first [`End`] | |
//!
//! The withdrawal of an offer is confirmed, but the receipt of a message is not. Streams overtake the control stream,
//! so a message of an offer that was wanted earlier, or that has ended, is discarded. Only a message that can never
//! have been requested is a violation.

mod duplicates;
mod input;
mod offers;

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};
use core::time::Duration;

use self::offers::{OwnOffers, PeerOffers};
pub use self::{
    duplicates::{Candidate, Initiator, older_stays},
    input::{
        Command, ControlCommand, End, Error, Event, Input, Misuse, Output, PeerEvent, Transport,
    },
};
use super::{
    AskId, Frame, FrameReader, GatewayId, Header, HeaderKind, Hop, OfferId, PeerFarewell,
    PeerViolation, PeerViolationKind, StreamToken, Subject,
};
use crate::{Instant, Machine, Name, limits::QUESTIONS_MAX, machine::debug_assert_drained};

/// The versions that this machine speaks.
const VERSION: u16 = 1;
/// The longest time that a peer may take to send HELLO.
const GREETING_TIMEOUT: Duration = Duration::from_secs(2);

/// One connection with one peer.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct PeerSession {
    me: Hop,
    peer: GatewayId,
    /// The epoch of the peer in another connection that is open, or 0.
    least_epoch: u64,
    state: Result<Phase, End>,
    reader: FrameReader,
    own_offers: OwnOffers,
    peer_offers: PeerOffers,
    /// The calls of this side without a reply, each with its offer.
    calls: BTreeMap<StreamToken, OfferId>,
    /// The questions of this side without an answer, the oldest first.
    asked: VecDeque<AskId>,
    /// The questions of the peer without an answer, the oldest first.
    unanswered: VecDeque<AskId>,
    outputs: VecDeque<Output>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Phase {
    Greeting { until: Instant },
    Open { epoch: u64 },
}

impl PeerSession {
    /// A session on a connection whose handshake has just proven that the other side is `peer`.
    /// `least_epoch` is the epoch of this peer in another connection that is open, or 0. A HELLO with a
    /// smaller one is refused.
    #[must_use]
    pub fn new(now: Instant, me: Hop, name: Name, peer: GatewayId, least_epoch: u64) -> Self {
        let hello = Frame::Hello {
            min_version: VERSION,
            max_version: VERSION,
            epoch: me.epoch,
            name,
        };
        Self {
            me,
            peer,
            least_epoch,
            state: Ok(Phase::Greeting {
                until: now.after(GREETING_TIMEOUT),
            }),
            reader: FrameReader::default(),
            own_offers: OwnOffers::default(),
            peer_offers: PeerOffers::default(),
            calls: BTreeMap::new(),
            asked: VecDeque::new(),
            unanswered: VecDeque::new(),
            outputs: VecDeque::from([Output::Transmit(hello.to_bytes())]),
        }
    }

    /// Why the session has ended, if it has.
    #[must_use]
    pub const fn end(&self) -> Option<End> {
        match self.state {
            Err(end) => Some(end),
            Ok(_) => None,
        }
    }

    /// The one place where a violation ends the session.
    fn event(&mut self, event: PeerEvent<'_>) -> Result<(), End> {
        let judged = match event {
            PeerEvent::Control(bytes) => {
                self.reader.push(bytes);
                self.read()
            }
            PeerEvent::Header { transport, header } => self.header(transport, &header),
            PeerEvent::Violation(violation) => Err(violation),
            PeerEvent::Closed(code) => {
                self.finish(End::Closed(code));
                Ok(())
            }
        };
        judged.map_err(|violation| {
            let end = End::Violation(violation);
            self.finish(end);
            end
        })
    }

    //= SM2-GWF-001
    fn check_greeting(&mut self, now: Instant) {
        if self.deadline().is_some_and(|until| until <= now) {
            self.finish(End::Local(PeerFarewell::GreetingTimeout.code()));
        }
    }

    fn command(&mut self, command: Command) -> Result<(), Misuse> {
        if !matches!(self.state, Ok(Phase::Open { .. })) {
            return Err(Misuse::NotOpen);
        }
        let frame = match command {
            Command::Offer {
                offer,
                subject,
                path,
            } => self.offer(offer, subject, path)?,
            Command::Control(command) => match self.control(command)? {
                Some(frame) => frame,
                None => return Ok(()),
            },
            Command::Call { stream, offer } => {
                if self.calls.contains_key(&stream) {
                    return Err(Misuse::StreamInUse);
                }
                self.peer_offers.check_call(offer)?;
                self.calls.insert(stream, offer);
                return Ok(());
            }
            Command::Forget { stream } => {
                let call = self.calls.remove(&stream);
                return call.map(|_| ()).ok_or(Misuse::NoCall);
            }
        };
        self.outputs.push_back(Output::Transmit(frame.to_bytes()));
        Ok(())
    }

    /// The frame that the command leads to; `None` if the frame has to wait, or is not needed.
    fn control(&mut self, command: ControlCommand) -> Result<Option<Frame>, Misuse> {
        Ok(Some(match command {
            ControlCommand::Unoffer { offer } => {
                self.own_offers.withdraw(offer)?;
                Frame::Unoffer { offer }
            }
            ControlCommand::Want { offer, depth } => {
                if !self.peer_offers.want(offer, depth)? {
                    return Ok(None);
                }
                Frame::Want { offer, depth }
            }
            ControlCommand::Unwant { offer } => {
                if !self.peer_offers.unwant(offer)? {
                    return Ok(None);
                }
                self.fail_calls(|it| it == offer);
                Frame::Unwant { offer }
            }
            ControlCommand::Ask { ask, kind, name } => {
                if self.asked.len() >= QUESTIONS_MAX {
                    return Err(Misuse::TooManyQuestions);
                }
                self.asked.push_back(ask);
                Frame::Ask { ask, kind, name }
            }
            ControlCommand::Answer { ask, verdict } => {
                if self.unanswered.front() != Some(&ask) {
                    return Err(Misuse::NotAsked);
                }
                self.unanswered.pop_front();
                Frame::Answer { ask, verdict }
            }
        }))
    }

    //= SM2-GWO-001, SM2-GWO-003
    fn offer(&mut self, offer: OfferId, subject: Subject, path: Vec<Hop>) -> Result<Frame, Misuse> {
        let is_to_peer = path.iter().any(|it| it.gateway == self.peer);
        if is_to_peer || path.last() != Some(&self.me) {
            return Err(Misuse::WrongPath);
        }
        let kind = subject.kind();
        let frame = Frame::Offer {
            offer,
            subject,
            path,
        };
        frame.check().map_err(|_| Misuse::WrongPath)?;
        self.own_offers.offer(offer, kind)?;
        Ok(frame)
    }

    /// Handles the complete frames of the control stream.
    fn read(&mut self) -> Result<(), PeerViolation> {
        while self.state.is_ok()
            && let Some(frame) = self.reader.next_frame()?
        {
            match self.state {
                Ok(Phase::Greeting { .. }) => self.greeting(frame)?,
                Ok(Phase::Open { epoch }) => self.frame(frame, epoch)?,
                Err(_) => {}
            }
        }
        Ok(())
    }

    //= SM2-GWF-001
    fn greeting(&mut self, frame: Frame) -> Result<(), PeerViolation> {
        let Frame::Hello {
            min_version,
            max_version,
            epoch,
            name,
        } = frame
        else {
            return Err(violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"));
        };
        if min_version == 0 || min_version > max_version {
            return Err(violation!(
                PeerViolationKind::BadVersionRange,
                "SM2-GWF-001"
            ));
        }
        if min_version > VERSION {
            self.finish(End::Local(PeerFarewell::Version.code()));
        } else if epoch < self.least_epoch {
            self.finish(End::Local(PeerFarewell::Stale.code()));
        } else {
            self.state = Ok(Phase::Open { epoch });
            let peer = self.peer;
            let greeted = Event::Greeted { peer, epoch, name };
            self.outputs.push_back(Output::Event(greeted));
        }
        Ok(())
    }

    fn frame(&mut self, frame: Frame, epoch: u64) -> Result<(), PeerViolation> {
        let event = match frame {
            Frame::Hello { .. } => {
                return Err(violation!(
                    PeerViolationKind::UnexpectedHello,
                    "SM2-GWF-001"
                ));
            }
            Frame::Offer {
                offer,
                subject,
                path,
            } => {
                self.check_path(&path, epoch)?;
                self.peer_offers.offered(offer, subject.kind())?;
                Event::Offered {
                    offer,
                    subject,
                    path,
                }
            }
            Frame::Unoffer { offer } => {
                self.peer_offers.gone(offer)?;
                self.fail_calls(|it| it == offer);
                let answer = Frame::Unoffered { offer };
                self.outputs.push_back(Output::Transmit(answer.to_bytes()));
                Event::Gone { offer }
            }
            Frame::Unoffered { offer } => return self.own_offers.gone(offer),
            Frame::Want { offer, depth } => {
                if !self.own_offers.wanted(offer)? {
                    return Ok(());
                }
                Event::Wanted { offer, depth }
            }
            Frame::Unwant { offer } => {
                if !self.own_offers.unwanted(offer)? {
                    return Ok(());
                }
                let answer = Frame::Unwanted { offer };
                self.outputs.push_back(Output::Transmit(answer.to_bytes()));
                Event::Unwanted { offer }
            }
            Frame::Unwanted { offer } => {
                let Some(depth) = self.peer_offers.unwanted(offer)? else {
                    return Ok(());
                };
                let again = Frame::Want { offer, depth };
                self.outputs.push_back(Output::Transmit(again.to_bytes()));
                return Ok(());
            }
            Frame::Ask { ask, kind, name } => {
                self.asked_by_peer(ask)?;
                Event::Asked { ask, kind, name }
            }
            Frame::Answer { ask, verdict } => {
                self.answered_by_peer(ask)?;
                Event::Answered { ask, verdict }
            }
        };
        self.outputs.push_back(Output::Event(event));
        Ok(())
    }

    //= SM2-GWO-006
    fn asked_by_peer(&mut self, ask: AskId) -> Result<(), PeerViolation> {
        if self.unanswered.len() >= QUESTIONS_MAX {
            return Err(violation!(PeerViolationKind::Malformed, "SM2-GWO-006"));
        }
        self.unanswered.push_back(ask);
        Ok(())
    }

    //= SM2-GWO-006
    fn answered_by_peer(&mut self, ask: AskId) -> Result<(), PeerViolation> {
        if self.asked.front() != Some(&ask) {
            return Err(violation!(
                PeerViolationKind::UnexpectedAnswer,
                "SM2-GWO-006"
            ));
        }
        self.asked.pop_front();
        Ok(())
    }

    //= SM2-GWO-003
    fn check_path(&self, path: &[Hop], epoch: u64) -> Result<(), PeerViolation> {
        let sender = Hop {
            gateway: self.peer,
            epoch,
        };
        let comes_back = path.iter().any(|it| it.gateway == self.me.gateway);
        if comes_back || path.last() != Some(&sender) {
            return Err(violation!(PeerViolationKind::BadPath, "SM2-GWO-003"));
        }
        Ok(())
    }

    /// Judges the header of a message, a request or a reply: the table of SPEC, Annex B.10.
    //= SM2-GWM-001, SM2-GWM-003, SM2-GWS-001
    fn header(&mut self, transport: Transport, header: &Header) -> Result<(), PeerViolation> {
        if !matches!(self.state, Ok(Phase::Open { .. })) {
            return Err(violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"));
        }
        let offer = header.offer;
        let output = match (header.kind, transport) {
            (HeaderKind::Message { .. }, _) if self.peer_offers.admit(offer)? => {
                Output::Take { transport }
            }
            (HeaderKind::Message { .. }, _) => Output::Discard { transport },
            (HeaderKind::Request { .. }, Transport::Stream(_))
                if self.own_offers.admit(offer)? =>
            {
                Output::Take { transport }
            }
            (HeaderKind::Request { .. }, Transport::Stream(stream)) => {
                Output::Unreachable { stream }
            }
            (HeaderKind::Reply { .. }, Transport::Stream(stream)) => {
                // The call of this stream stays open, so that `finish` fails it.
                if self.calls.get(&stream) != Some(&offer) {
                    return Err(violation!(PeerViolationKind::UnknownCall, "SM2-GWS-002"));
                }
                self.calls.remove(&stream);
                Output::Take { transport }
            }
            (HeaderKind::Request { .. } | HeaderKind::Reply { .. }, Transport::Datagram) => {
                return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-003"));
            }
        };
        self.outputs.push_back(output);
        Ok(())
    }

    /// Fails the calls of the offers that `of` selects.
    //= SM2-GWS-002
    fn fail_calls(&mut self, of: impl Fn(OfferId) -> bool) {
        let outputs = &mut self.outputs;
        self.calls.retain(|&stream, offer| {
            let fails = of(*offer);
            outputs.extend(fails.then_some(Output::CallFailed { stream }));
            !fails
        });
    }

    /// The one place where a session ends.
    fn finish(&mut self, end: End) {
        self.state = Err(end);
        self.fail_calls(|_| true);
        self.outputs.push_back(Output::Ended(end));
    }
}

impl Machine for PeerSession {
    type Input<'a> = Input<'a>;
    type Output = Output;
    type End = End;
    type Misuse = Misuse;

    /// Feeds one input.
    ///
    /// # Errors
    /// [`Error::Misuse`]: this input is not legal now, and nothing has changed.
    /// [`Error::Ended`]: the session has ended, perhaps by a violation in this very input; the
    /// outputs say the rest. Every other end shows only as [`Output::Ended`] at first.
    fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), Error> {
        debug_assert_drained(&self.outputs);
        self.state.map_err(Error::Ended)?;
        match input {
            Input::Event(event) => self.event(event).map_err(Error::Ended)?,
            Input::Command(command) => self.command(command)?,
            Input::Close(code) => self.finish(End::Local(code)),
            Input::Tick => self.check_greeting(now),
        }
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The latest time for the greeting of the peer.
    fn deadline(&self) -> Option<Instant> {
        match self.state {
            Ok(Phase::Greeting { until }) => Some(until),
            _ => None,
        }
    }
}
