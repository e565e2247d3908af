//! The offers of both sides: the tables of SPEC section 14.3.

use alloc::collections::BTreeMap;

use super::{
    super::{OfferId, PeerViolation, PeerViolationKind, SubjectKind},
    Misuse,
};
use crate::limits::{OFFERS_MAX, QOS_MAX};

/// What this side offers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Ours {
    offers: BTreeMap<OfferId, (SubjectKind, Our)>,
    last: OfferId,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Our {
    Offered,
    Wanted,
    /// UNOFFER was sent.
    Withdrawing,
}

/// What the peer offers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Theirs {
    offers: BTreeMap<OfferId, Their>,
    last: OfferId,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Their {
    kind: SubjectKind,
    interest: Interest,
    /// Whether WANT was ever sent.
    was_wanted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Interest {
    None,
    /// WANT was sent.
    Wanting,
    /// UNWANT was sent; whether it is wanted again once that is confirmed, and how.
    Unwanting {
        again: Option<u16>,
    },
}

impl Ours {
    //= SM2-GWO-001
    pub(super) fn offer(&mut self, offer: OfferId, kind: SubjectKind) -> Result<(), Misuse> {
        if offer <= self.last {
            return Err(Misuse::OfferNumber);
        }
        if self.offers.len() >= OFFERS_MAX {
            return Err(Misuse::TooManyOffers);
        }
        self.last = offer;
        self.offers.insert(offer, (kind, Our::Offered));
        Ok(())
    }

    pub(super) fn withdraw(&mut self, offer: OfferId) -> Result<(), Misuse> {
        match self.offers.get_mut(&offer) {
            Some((_, state)) if *state != Our::Withdrawing => {
                *state = Our::Withdrawing;
                Ok(())
            }
            _ => Err(Misuse::WrongOffer),
        }
    }

    fn state(&mut self, offer: OfferId) -> Result<&mut Our, PeerViolation> {
        let it = self.offers.get_mut(&offer);
        it.map(|(_, state)| state)
            .ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
    }

    /// WANT came: whether that means anything.
    //= SM2-GWO-002
    pub(super) fn wanted(&mut self, offer: OfferId) -> Result<bool, PeerViolation> {
        let state = self.state(offer)?;
        match state {
            Our::Offered => *state = Our::Wanted,
            Our::Wanted => return Err(violation!(PeerViolationKind::BadWant, "SM2-GWO-002")),
            Our::Withdrawing => return Ok(false),
        }
        Ok(true)
    }

    /// UNWANT came: whether that means anything.
    //= SM2-GWO-002
    pub(super) fn unwanted(&mut self, offer: OfferId) -> Result<bool, PeerViolation> {
        let state = self.state(offer)?;
        match state {
            Our::Offered => return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002")),
            Our::Wanted => *state = Our::Offered,
            Our::Withdrawing => return Ok(false),
        }
        Ok(true)
    }

    /// UNOFFERED came.
    //= SM2-GWO-002
    pub(super) fn gone(&mut self, offer: OfferId) -> Result<(), PeerViolation> {
        match self.state(offer)? {
            Our::Withdrawing => {
                self.offers.remove(&offer);
                Ok(())
            }
            Our::Offered | Our::Wanted => {
                Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
            }
        }
    }

    /// A call came: whether its server can be reached.
    //= SM2-GWS-001
    pub(super) fn admit(&self, offer: OfferId) -> Result<bool, PeerViolation> {
        match self.offers.get(&offer) {
            Some((SubjectKind::Service, state)) => Ok(*state == Our::Wanted),
            None if (OfferId(1)..=self.last).contains(&offer) => Ok(false),
            Some((SubjectKind::Topic, _)) | None => {
                Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWS-001"))
            }
        }
    }
}

impl Theirs {
    /// OFFER came.
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
        let their = Their {
            kind,
            interest: Interest::None,
            was_wanted: false,
        };
        self.offers.insert(offer, their);
        Ok(())
    }

    /// Whether to say so now.
    pub(super) fn want(&mut self, offer: OfferId, depth: u16) -> Result<bool, Misuse> {
        if !(1..=QOS_MAX).contains(&depth) {
            return Err(Misuse::WrongDepth);
        }
        let their = self.offers.get_mut(&offer).ok_or(Misuse::WrongOffer)?;
        let (interest, now) = match their.interest {
            Interest::None => (Interest::Wanting, true),
            Interest::Unwanting { again: None } => {
                let again = Some(depth);
                (Interest::Unwanting { again }, false)
            }
            Interest::Wanting | Interest::Unwanting { again: Some(_) } => {
                return Err(Misuse::WrongOffer);
            }
        };
        (their.interest, their.was_wanted) = (interest, true);
        Ok(now)
    }

    /// Whether to say so now.
    pub(super) fn unwant(&mut self, offer: OfferId) -> Result<bool, Misuse> {
        let their = self.offers.get_mut(&offer).ok_or(Misuse::WrongOffer)?;
        let now = match their.interest {
            Interest::Wanting => true,
            Interest::Unwanting { again: Some(_) } => false,
            Interest::None | Interest::Unwanting { again: None } => {
                return Err(Misuse::WrongOffer);
            }
        };
        their.interest = Interest::Unwanting { again: None };
        Ok(now)
    }

    /// UNOFFER came.
    //= SM2-GWO-002
    pub(super) fn gone(&mut self, offer: OfferId) -> Result<(), PeerViolation> {
        let gone = self.offers.remove(&offer);
        gone.map(|_| ())
            .ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))
    }

    /// UNWANTED came. How it is wanted again, if it is.
    //= SM2-GWO-002
    pub(super) fn unwanted(&mut self, offer: OfferId) -> Result<Option<u16>, PeerViolation> {
        let their = self.offers.get_mut(&offer);
        let their = their.ok_or(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"))?;
        let Interest::Unwanting { again } = their.interest else {
            return Err(violation!(PeerViolationKind::UnknownOffer, "SM2-GWO-002"));
        };
        their.interest = again.map_or(Interest::None, |_| Interest::Wanting);
        Ok(again)
    }

    /// A message came: whether it is wanted.
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
            // Streams and frames have no common order.
            None if (OfferId(1)..=self.last).contains(&offer) => Ok(false),
            _ => Err(violation!(PeerViolationKind::NotWanted, "SM2-GWM-001")),
        }
    }

    pub(super) fn check_call(&self, offer: OfferId) -> Result<(), Misuse> {
        let their = self.offers.get(&offer);
        match their {
            Some(it) if it.kind == SubjectKind::Service && it.interest == Interest::Wanting => {
                Ok(())
            }
            _ => Err(Misuse::WrongOffer),
        }
    }
}
