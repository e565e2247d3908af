//! SPEC section 14 for one connection, in plain sets of numbers. The fuzz body compares each output
//! of the session with this oracle.

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec,
    vec::Vec,
};

use super::super::{
    AskId, Frame, GatewayId, Header, HeaderKind, Hop, OfferId, PeerFarewell, PeerViolation,
    PeerViolationKind, StreamToken, Subject, SubjectKind,
    session::{Command, ControlCommand, End, Event, Output, Transport},
};

/// Everything that both sides have sent and that still has an effect.
pub(super) struct Oracle {
    pub(super) me: Hop,
    pub(super) peer: GatewayId,
    /// The greatest epoch of the peer that was seen before.
    pub(super) least_epoch: u64,
    /// The epoch in the HELLO of the peer, if it has come.
    pub(super) greeted: Option<u64>,
    /// The offers of this side that are not gone, and those of them that were withdrawn.
    pub(super) offered: BTreeMap<OfferId, SubjectKind>,
    pub(super) withdrawn: BTreeSet<OfferId>,
    pub(super) last_offered: OfferId,
    /// The offers of this side that the peer wants.
    pub(super) wanted: BTreeSet<OfferId>,
    /// The offers of the peer.
    pub(super) known: BTreeMap<OfferId, SubjectKind>,
    pub(super) last_known: OfferId,
    /// The offers of the peer that the driver wants, with their depths, and all that it ever wanted.
    pub(super) wishes: BTreeMap<OfferId, u16>,
    pub(super) wished: BTreeSet<OfferId>,
    /// For each offer of the peer, true after WANT was sent and false after UNWANT was sent. UNWANTED
    /// removes the entry.
    pub(super) said: BTreeMap<OfferId, bool>,
    /// The calls to the peer without a reply, by stream, with their offers.
    pub(super) calls: BTreeMap<StreamToken, OfferId>,
    /// The questions to the peer and of the peer without an answer.
    pub(super) asked: VecDeque<AskId>,
    pub(super) owed: VecDeque<AskId>,
}

impl Oracle {
    pub(super) fn new(me: Hop, peer: GatewayId, least_epoch: u64) -> Self {
        Self {
            me,
            peer,
            least_epoch,
            greeted: None,
            offered: BTreeMap::new(),
            withdrawn: BTreeSet::new(),
            last_offered: OfferId(0),
            wanted: BTreeSet::new(),
            known: BTreeMap::new(),
            last_known: OfferId(0),
            wishes: BTreeMap::new(),
            wished: BTreeSet::new(),
            said: BTreeMap::new(),
            calls: BTreeMap::new(),
            asked: VecDeque::new(),
            owed: VecDeque::new(),
        }
    }

    /// The outputs, or the end, that a frame of the peer leads to.
    pub(super) fn hears(&mut self, frame: Frame) -> Result<Vec<Output>, End> {
        match (self.greeted, frame) {
            (
                None,
                Frame::Hello {
                    min_version,
                    max_version,
                    epoch,
                    name,
                },
            ) => {
                if min_version < 1 || max_version < min_version {
                    return Err(End::Violation(violation!(
                        PeerViolationKind::BadVersionRange,
                        "SM2-GWF-001"
                    )));
                }
                if min_version > 1 {
                    return Err(End::Local(PeerFarewell::Version.code()));
                }
                if epoch < self.least_epoch {
                    return Err(End::Local(PeerFarewell::Stale.code()));
                }
                self.greeted = Some(epoch);
                let peer = self.peer;
                Ok(vec![Output::Event(Event::Greeted { peer, epoch, name })])
            }
            (None, _) => Err(End::Violation(violation!(
                PeerViolationKind::ExpectedHello,
                "SM2-GWF-001"
            ))),
            (Some(epoch), frame) => self.judges(frame, epoch).map_err(End::Violation),
        }
    }

    fn judges(&mut self, frame: Frame, epoch: u64) -> Result<Vec<Output>, PeerViolation> {
        match frame {
            Frame::Hello { .. } => Err(violation!(
                PeerViolationKind::UnexpectedHello,
                "SM2-GWF-001"
            )),
            Frame::Offer { .. } | Frame::Unoffer { .. } | Frame::Unwanted { .. } => {
                self.judges_theirs(frame, epoch)
            }
            Frame::Unoffered { .. } | Frame::Want { .. } | Frame::Unwant { .. } => {
                self.judges_ours(frame)
            }
            Frame::Ask { ask, kind, name } => {
                if self.owed.len() == 64 {
                    return Err(violation!(PeerViolationKind::Malformed, "SM2-GWO-006"));
                }
                self.owed.push_back(ask);
                Ok(vec![Output::Event(Event::Asked { ask, kind, name })])
            }
            Frame::Answer { ask, verdict } => {
                if self.asked.front() != Some(&ask) {
                    return Err(violation!(
                        PeerViolationKind::UnexpectedAnswer,
                        "SM2-GWO-006"
                    ));
                }
                self.asked.pop_front();
                Ok(vec![Output::Event(Event::Answered { ask, verdict })])
            }
        }
    }

    /// Judges a frame about an offer of the peer.
    fn judges_theirs(&mut self, frame: Frame, epoch: u64) -> Result<Vec<Output>, PeerViolation> {
        Ok(match frame {
            Frame::Offer {
                offer,
                subject,
                path,
            } => {
                let gateway = self.peer;
                let passed_here = path.iter().any(|hop| hop.gateway == self.me.gateway);
                if passed_here || path.last() != Some(&Hop { gateway, epoch }) {
                    return Err(violation!(PeerViolationKind::BadPath, "SM2-GWO-003"));
                }
                if offer <= self.last_known {
                    return Err(violation!(PeerViolationKind::BadOffer, "SM2-GWO-001"));
                }
                if self.known.len() == 4_096 {
                    return Err(violation!(PeerViolationKind::OfferLimit, "SM2-GWO-001"));
                }
                self.last_known = offer;
                self.known.insert(offer, subject.kind());
                vec![Output::Event(Event::Offered {
                    offer,
                    subject,
                    path,
                })]
            }
            Frame::Unoffer { offer } => {
                if self.known.remove(&offer).is_none() {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
                }
                self.said.remove(&offer);
                self.wishes.remove(&offer);
                let mut outputs = self.fail_calls(Some(offer));
                outputs.push(transmit(&Frame::Unoffered { offer }));
                outputs.push(Output::Event(Event::Gone { offer }));
                outputs
            }
            Frame::Unwanted { offer } => {
                if self.said.get(&offer) != Some(&false) {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
                }
                self.said.remove(&offer);
                let again = self.wishes.get(&offer).copied();
                let want = again.map(|depth| {
                    self.said.insert(offer, true);
                    transmit(&Frame::Want { offer, depth })
                });
                want.into_iter().collect()
            }
            other => unreachable!("{other:?} says nothing of the peer's offers"),
        })
    }

    /// Judges a frame about an offer of this side.
    fn judges_ours(&mut self, frame: Frame) -> Result<Vec<Output>, PeerViolation> {
        Ok(match frame {
            Frame::Unoffered { offer } => {
                if !self.withdrawn.remove(&offer) {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
                }
                self.offered.remove(&offer);
                vec![]
            }
            Frame::Want { offer, .. } | Frame::Unwant { offer }
                if self.withdrawn.contains(&offer) =>
            {
                vec![]
            }
            Frame::Want { offer, depth } => {
                if !self.offered.contains_key(&offer) {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
                }
                if !self.wanted.insert(offer) {
                    return Err(violation!(PeerViolationKind::BadWant, "SM2-GWO-002"));
                }
                vec![Output::Event(Event::Wanted { offer, depth })]
            }
            Frame::Unwant { offer } => {
                if !self.wanted.remove(&offer) {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
                }
                let answer = transmit(&Frame::Unwanted { offer });
                vec![answer, Output::Event(Event::Unwanted { offer })]
            }
            other => unreachable!("{other:?} says nothing of this side's offers"),
        })
    }

    /// The output that the header of a stream or datagram leads to.
    pub(super) fn sees(
        &mut self,
        transport: Transport,
        header: &Header,
    ) -> Result<Output, PeerViolation> {
        let offer = header.offer;
        if self.greeted.is_none() {
            return Err(violation!(PeerViolationKind::ExpectedHello, "SM2-GWF-001"));
        }
        let stream = match (header.kind, transport) {
            (_, Transport::Stream(stream)) => stream,
            // A message in a datagram has no stream.
            (HeaderKind::Message { .. }, Transport::Datagram) => StreamToken(0),
            (HeaderKind::Request { .. } | HeaderKind::Reply { .. }, Transport::Datagram) => {
                return Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-003"));
            }
        };
        Ok(match header.kind {
            HeaderKind::Message { .. } => {
                let is_gone = offer <= self.last_known && !self.known.contains_key(&offer);
                let is_topic = self.known.get(&offer) == Some(&SubjectKind::Topic);
                if self.wishes.contains_key(&offer) && is_topic {
                    Output::Take { transport }
                } else if offer.0 > 0 && (is_gone || (is_topic && self.wished.contains(&offer))) {
                    Output::Discard { transport }
                } else {
                    return Err(violation!(PeerViolationKind::NotWanted, "SM2-GWM-001"));
                }
            }
            HeaderKind::Request { .. } => {
                let is_gone = offer <= self.last_offered && !self.offered.contains_key(&offer);
                let is_service = self.offered.get(&offer) == Some(&SubjectKind::Service);
                if offer.0 == 0 || !(is_gone || is_service) {
                    return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWS-001"));
                }
                if self.wanted.contains(&offer) {
                    Output::Take { transport }
                } else {
                    Output::Unreachable { stream }
                }
            }
            HeaderKind::Reply { .. } => {
                if self.calls.get(&stream) != Some(&offer) {
                    return Err(violation!(PeerViolationKind::UnknownCall, "SM2-GWS-002"));
                }
                self.calls.remove(&stream);
                Output::Take { transport }
            }
        })
    }

    /// The outputs that a command leads to; none if the command is a misuse.
    pub(super) fn asks(&mut self, command: &Command) -> Option<Vec<Output>> {
        self.greeted?;
        let frame = match command.clone() {
            Command::Offer {
                offer,
                subject,
                path,
            } => self.asks_offer(offer, subject, path)?,
            Command::Control(command) => return self.asks_control(command),
            Command::Call { stream, offer } => {
                let is_service = self.known.get(&offer) == Some(&SubjectKind::Service);
                let is_wanted = self.said.get(&offer) == Some(&true);
                let is_free = !self.calls.contains_key(&stream);
                return (is_service && is_wanted && is_free).then(|| {
                    self.calls.insert(stream, offer);
                    vec![]
                });
            }
            Command::Forget { stream } => return self.calls.remove(&stream).map(|_| vec![]),
        };
        Some(vec![transmit(&frame)])
    }

    fn asks_control(&mut self, command: ControlCommand) -> Option<Vec<Output>> {
        let frame = match command {
            ControlCommand::Unoffer { offer } => {
                if !self.offered.contains_key(&offer) || !self.withdrawn.insert(offer) {
                    return None;
                }
                self.wanted.remove(&offer);
                Frame::Unoffer { offer }
            }
            ControlCommand::Want { offer, depth } => return self.asks_want(offer, depth),
            ControlCommand::Unwant { offer } => return self.asks_unwant(offer),
            ControlCommand::Ask { ask, kind, name } => {
                if self.asked.len() == 64 {
                    return None;
                }
                self.asked.push_back(ask);
                Frame::Ask { ask, kind, name }
            }
            ControlCommand::Answer { ask, verdict } => {
                self.owed.front().filter(|it| **it == ask)?;
                self.owed.pop_front();
                Frame::Answer { ask, verdict }
            }
        };
        Some(vec![transmit(&frame)])
    }

    fn asks_offer(&mut self, offer: OfferId, subject: Subject, path: Vec<Hop>) -> Option<Frame> {
        let mut gateways: BTreeSet<_> = path.iter().map(|hop| hop.gateway).collect();
        let is_path = gateways.len() == path.len()
            && path.len() <= 8
            && gateways.insert(self.peer)
            && path.last() == Some(&self.me);
        if !is_path || offer <= self.last_offered || self.offered.len() == 4_096 {
            return None;
        }
        self.last_offered = offer;
        self.offered.insert(offer, subject.kind());
        Some(Frame::Offer {
            offer,
            subject,
            path,
        })
    }

    fn asks_want(&mut self, offer: OfferId, depth: u16) -> Option<Vec<Output>> {
        let is_free = self.known.contains_key(&offer) && !self.wishes.contains_key(&offer);
        if !is_free || !(1..=1_024).contains(&depth) {
            return None;
        }
        self.wishes.insert(offer, depth);
        self.wished.insert(offer);
        if self.said.contains_key(&offer) {
            return Some(vec![]);
        }
        self.said.insert(offer, true);
        Some(vec![transmit(&Frame::Want { offer, depth })])
    }

    fn asks_unwant(&mut self, offer: OfferId) -> Option<Vec<Output>> {
        self.wishes.remove(&offer)?;
        if self.said.insert(offer, false) == Some(false) {
            return Some(vec![]);
        }
        let mut outputs = self.fail_calls(Some(offer));
        outputs.push(transmit(&Frame::Unwant { offer }));
        Some(outputs)
    }

    /// Fails the calls of an offer, or all calls.
    pub(super) fn fail_calls(&mut self, of: Option<OfferId>) -> Vec<Output> {
        let fails = |offer: OfferId| of.is_none_or(|it| it == offer);
        let failed: Vec<StreamToken> = self
            .calls
            .iter()
            .filter(|it| fails(*it.1))
            .map(|it| *it.0)
            .collect();
        self.calls.retain(|_, offer| !fails(*offer));
        let output = |stream| Output::CallFailed { stream };
        failed.into_iter().map(output).collect()
    }
}

fn transmit(frame: &Frame) -> Output {
    Output::Transmit(frame.to_bytes())
}
