//! The offers of both sides, as the tables of SPEC section 14.3 have them.

use alloc::collections::BTreeMap;

use super::{
    super::{OfferId, PeerViolation, PeerViolationKind, SubjectKind},
    Misuse,
};
use crate::limits::{OFFERS_MAX, QOS_MAX};

/// The offers of this side.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct OwnOffers {
    offers: BTreeMap<OfferId, (SubjectKind, OwnOffer)>,
    /// The greatest number that was used.
    last: OfferId,
}

/// The state of an offer of this side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum OwnOffer {
    /// The peer does not want the offer.
    Offered,
    /// The peer wants the offer.
    Wanted,
    /// UNOFFER was sent.
    Withdrawing,
}

/// The offers of the peer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct PeerOffers {
    offers: BTreeMap<OfferId, PeerOffer>,
    /// The greatest number that the peer has used.
    last: OfferId,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct PeerOffer {
    kind: SubjectKind,
    interest: Interest,
    /// Whether WANT was ever sent.
    was_wanted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Interest {
    /// The offer is known; it is not wanted.
    None,
    /// WANT was sent.
    Wanting,
    /// UNWANT was sent. `again` is the depth of the WANT that follows UNWANTED, if one does.
    Unwanting { again: Option<u16> },
}

impl OwnOffers {
    //= SM2-GWO-001
    pub(super) fn offer(&mut self, offer: OfferId, kind: SubjectKind) -> Result<(), Misuse> {
        if offer <= self.last {
            return Err(Misuse::OfferNumber);
        }
        if self.offers.len() >= OFFERS_MAX {
            return Err(Misuse::TooManyOffers);
        }
        self.last = offer;
        self.offers.insert(offer, (kind, OwnOffer::Offered));
        Ok(())
    }

    pub(super) fn withdraw(&mut self, offer: OfferId) -> Result<(), Misuse> {
        match self.offers.get_mut(&offer) {
            Some((_, state)) if *state != OwnOffer::Withdrawing => {
                *state = OwnOffer::Withdrawing;
                Ok(())
            }
            _ => Err(Misuse::WrongOffer),
        }
    }

    fn state(&mut self, offer: OfferId) -> Result<&mut OwnOffer, PeerViolation> {
        let it = self.offers.get_mut(&offer);
        it.map(|(_, state)| state)
            .ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
    }

    /// Handles WANT. False if the offer is being withdrawn: then WANT has no effect.
    //= SM2-GWO-002
    pub(super) fn wanted(&mut self, offer: OfferId) -> Result<bool, PeerViolation> {
        let state = self.state(offer)?;
        match state {
            OwnOffer::Offered => *state = OwnOffer::Wanted,
            OwnOffer::Wanted => return Err(violation!(PeerViolationKind::BadWant, "SM2-GWO-002")),
            OwnOffer::Withdrawing => return Ok(false),
        }
        Ok(true)
    }

    /// Handles UNWANT. False if the offer is being withdrawn: then UNWANT has no effect.
    //= SM2-GWO-002
    pub(super) fn unwanted(&mut self, offer: OfferId) -> Result<bool, PeerViolation> {
        let state = self.state(offer)?;
        match state {
            OwnOffer::Offered => {
                return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
            }
            OwnOffer::Wanted => *state = OwnOffer::Offered,
            OwnOffer::Withdrawing => return Ok(false),
        }
        Ok(true)
    }

    /// Handles UNOFFERED.
    //= SM2-GWO-002
    pub(super) fn gone(&mut self, offer: OfferId) -> Result<(), PeerViolation> {
        match self.state(offer)? {
            OwnOffer::Withdrawing => {
                self.offers.remove(&offer);
                Ok(())
            }
            OwnOffer::Offered | OwnOffer::Wanted => {
                Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
            }
        }
    }

    /// Judges the header of a call. False if the call is to be answered with *unreachable*.
    //= SM2-GWS-001
    pub(super) fn admit(&self, offer: OfferId) -> Result<bool, PeerViolation> {
        match self.offers.get(&offer) {
            Some((SubjectKind::Service, state)) => Ok(*state == OwnOffer::Wanted),
            None if (OfferId(1)..=self.last).contains(&offer) => Ok(false),
            Some((SubjectKind::Topic, _)) | None => {
                Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWS-001"))
            }
        }
    }
}

impl PeerOffers {
    /// Handles OFFER.
    //= SM2-GWO-001
    pub(super) fn offered(
        &mut self,
        offer: OfferId,
        kind: SubjectKind,
    ) -> Result<(), PeerViolation> {
        if offer <= self.last {
            return Err(violation!(PeerViolationKind::BadOffer, "SM2-GWO-001"));
        }
        if self.offers.len() >= OFFERS_MAX {
            return Err(violation!(PeerViolationKind::OfferLimit, "SM2-GWO-001"));
        }
        self.last = offer;
        let found = PeerOffer {
            kind,
            interest: Interest::None,
            was_wanted: false,
        };
        self.offers.insert(offer, found);
        Ok(())
    }

    /// Wants an offer. False if WANT has to wait for UNWANTED.
    pub(super) fn want(&mut self, offer: OfferId, depth: u16) -> Result<bool, Misuse> {
        if !(1..=QOS_MAX).contains(&depth) {
            return Err(Misuse::WrongDepth);
        }
        let found = self.offers.get_mut(&offer).ok_or(Misuse::WrongOffer)?;
        let (interest, now) = match found.interest {
            Interest::None => (Interest::Wanting, true),
            Interest::Unwanting { again: None } => {
                let again = Some(depth);
                (Interest::Unwanting { again }, false)
            }
            Interest::Wanting | Interest::Unwanting { again: Some(_) } => {
                return Err(Misuse::WrongOffer);
            }
        };
        (found.interest, found.was_wanted) = (interest, true);
        Ok(now)
    }

    /// Ends a want. False if only a WANT that waits for UNWANTED is forgotten.
    pub(super) fn unwant(&mut self, offer: OfferId) -> Result<bool, Misuse> {
        let found = self.offers.get_mut(&offer).ok_or(Misuse::WrongOffer)?;
        let now = match found.interest {
            Interest::Wanting => true,
            Interest::Unwanting { again: Some(_) } => false,
            Interest::None | Interest::Unwanting { again: None } => {
                return Err(Misuse::WrongOffer);
            }
        };
        found.interest = Interest::Unwanting { again: None };
        Ok(now)
    }

    /// Handles UNOFFER.
    //= SM2-GWO-002
    pub(super) fn gone(&mut self, offer: OfferId) -> Result<(), PeerViolation> {
        let gone = self.offers.remove(&offer);
        gone.map(|_| ())
            .ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
    }

    /// Handles UNWANTED. Returns the depth of the WANT that has waited for it, if there is one.
    //= SM2-GWO-002
    pub(super) fn unwanted(&mut self, offer: OfferId) -> Result<Option<u16>, PeerViolation> {
        let found = self.offers.get_mut(&offer);
        let found = found.ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))?;
        let Interest::Unwanting { again } = found.interest else {
            return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
        };
        found.interest = again.map_or(Interest::None, |_| Interest::Wanting);
        Ok(again)
    }

    /// Judges the header of a message. False if the message is to be discarded.
    //= SM2-GWM-001
    pub(super) fn admit(&self, offer: OfferId) -> Result<bool, PeerViolation> {
        match self.offers.get(&offer) {
            Some(it) if it.kind == SubjectKind::Topic && it.was_wanted => {
                let is_wanted = |it| {
                    matches!(
                        it,
                        Interest::Wanting | Interest::Unwanting { again: Some(_) }
                    )
                };
                Ok(is_wanted(it.interest))
            }
            // The offer is gone. Streams and frames have no common order, so this is not a violation.
            None if (OfferId(1)..=self.last).contains(&offer) => Ok(false),
            _ => Err(violation!(PeerViolationKind::NotWanted, "SM2-GWM-001")),
        }
    }

    /// Checks that a call of this offer is legal for this side.
    pub(super) fn check_call(&self, offer: OfferId) -> Result<(), Misuse> {
        let found = self.offers.get(&offer);
        match found {
            Some(it) if it.kind == SubjectKind::Service && it.interest == Interest::Wanting => {
                Ok(())
            }
            _ => Err(Misuse::WrongOffer),
        }
    }
}
