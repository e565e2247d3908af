//! One interface of a node and its ends of links (the tables in SPEC sections 4.3 and 11).

#[cfg(any(kani, test))]
pub(super) mod proofs;

use alloc::collections::BTreeMap;

use super::Misuse;
use crate::{
    Contract, LinkId, LinkKey, LinkQos, VERSION, Violation, control::LinkPeer, limits::LINKS_MAX,
    match_contracts,
};

/// The state of an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// No Manager has answered it; DECLARE goes out after CLAIMED.
    Queued,
    /// DECLARE is sent, and no Manager has granted the interface before.
    Declaring,
    /// DECLARED came in an earlier session, and DECLARE is not sent in this one.
    Dormant,
    /// DECLARED came in an earlier session, and DECLARE is sent in this one.
    Renewing,
    /// As *renewing*; the program has withdrawn the interface since.
    WithdrawalQueued,
    /// DECLARED came in this session.
    Live,
    /// An interface that a Manager has granted, and that the access policy denies now.
    Suspended,
    /// WITHDRAW is sent.
    Dropping,
}

/// The state of one end of a link (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Standing {
    /// Made in an earlier session, and not claimed in this one.
    Unclaimed,
    /// Made or claimed in this session; neither side has said farewell.
    Known,
    /// This node has said farewell.
    Left,
}

/// The fields of LINK that CLAIM repeats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Link {
    pub(super) key: LinkKey,
    pub(super) version: u16,
    pub(super) qos: LinkQos,
}

/// The effect of an answer to DECLARE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answered {
    /// The program's own DECLARE is answered: the program is told.
    First,
    /// A DECLARE that the machine repeated is answered.
    Renewed,
    /// As `Renewed`, but the program has withdrawn the interface since.
    WithdrawalQueued,
}

/// The effect of DECLARED or DECLARE_REFUSED for an interface that the Manager has answered before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judged {
    /// The program is told.
    Changed,
    /// None: the frame crossed WITHDRAW.
    Nothing,
}

/// The effect of withdrawing an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Withdrawal {
    /// WITHDRAW has to be sent.
    Send,
    /// WITHDRAW waits for the answer to DECLARE.
    Wait,
    /// The Manager does not know the interface, which is removed at once.
    Forget,
}

/// The answer to UNLINK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// UNLINKED, because the Manager said farewell first.
    Unlinked,
    /// None, because this node said farewell first.
    Crossed,
    /// None, because this node drops the interface.
    Nothing,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Interface {
    contract: Contract,
    state: State,
    links: BTreeMap<LinkId, (Standing, Link)>,
}

impl Interface {
    pub(super) const fn new(contract: Contract) -> Self {
        Self {
            contract,
            state: State::Queued,
            links: BTreeMap::new(),
        }
    }

    /// The contract, if DECLARE is due for the first time. The interface counts as declared from
    /// now on.
    pub(super) fn declare(&mut self) -> Option<&Contract> {
        self.step(State::Queued, State::Declaring)
    }

    /// The contract, if DECLARE has to be repeated in this session. The interface counts as
    /// declared from now on.
    //= SM2-RES-002, SM2-RES-010
    pub(super) fn renew(&mut self) -> Option<&Contract> {
        self.step(State::Dormant, State::Renewing)
    }

    fn step(&mut self, from: State, to: State) -> Option<&Contract> {
        if self.state != from {
            return None;
        }
        self.state = to;
        Some(&self.contract)
    }

    /// DECLARED has come.
    pub(super) fn declared(&mut self) -> Result<Answered, Violation> {
        let (state, answered) = match self.state {
            State::Declaring => (State::Live, Answered::First),
            State::Renewing => (State::Live, Answered::Renewed),
            State::WithdrawalQueued => (State::Dropping, Answered::WithdrawalQueued),
            _ => return Err(violation!(UnknownInterface, "SM2-IFC-002")),
        };
        self.state = state;
        Ok(answered)
    }

    /// DECLARE_REFUSED has come. Only a renewed interface stays. `is_denial`: the access policy is the
    /// reason, and the Manager keeps a renewed interface.
    //= SM2-RES-010
    pub(super) fn refused(&mut self, is_denial: bool) -> Result<Answered, Violation> {
        let (state, answered) = match self.state {
            State::Declaring => (State::Declaring, Answered::First),
            State::WithdrawalQueued if is_denial => (State::Dropping, Answered::WithdrawalQueued),
            State::WithdrawalQueued => (State::WithdrawalQueued, Answered::WithdrawalQueued),
            State::Renewing if is_denial => (State::Suspended, Answered::Renewed),
            State::Renewing => (State::Dormant, Answered::Renewed),
            _ => return Err(violation!(UnknownInterface, "SM2-IFC-002")),
        };
        self.state = state;
        Ok(answered)
    }

    /// Whether the Manager has answered DECLARE in this session and keeps the interface. Then
    /// DECLARED and DECLARE_REFUSED tell of a new access policy.
    //= SM2-ACC-013
    pub(super) const fn is_kept(&self) -> bool {
        matches!(self.state, State::Live | State::Suspended | State::Dropping)
    }

    /// The access policy allows a suspended interface again.
    //= SM2-ACC-013
    pub(super) fn allowed(&mut self) -> Result<Judged, Violation> {
        self.judged(self.state == State::Suspended, State::Live)
    }

    /// The access policy denies the interface. One that is suspended stays so, for this reason or
    /// another one.
    //= SM2-ACC-013
    pub(super) fn denied(&mut self, is_denial: bool) -> Result<Judged, Violation> {
        let is_legal = self.state == State::Suspended || (self.state == State::Live && is_denial);
        self.judged(is_legal, State::Suspended)
    }

    fn judged(&mut self, is_legal: bool, state: State) -> Result<Judged, Violation> {
        if self.state == State::Dropping {
            return Ok(Judged::Nothing);
        }
        if !is_legal {
            return Err(violation!(UnknownInterface, "SM2-IFC-002"));
        }
        self.state = state;
        Ok(Judged::Changed)
    }

    /// Removes and returns the links that are not claimed: the Manager does not adopt those of an
    /// interface that the access policy denies, and sends no UNLINK for them.
    //= SM2-RES-010
    pub(super) fn take_unclaimed(&mut self) -> impl Iterator<Item = LinkId> + use<> {
        let links = core::mem::take(&mut self.links).into_iter();
        let (unclaimed, rest): (BTreeMap<_, _>, _) =
            links.partition(|(_, (standing, _))| *standing == Standing::Unclaimed);
        self.links = rest;
        unclaimed.into_keys()
    }

    /// The program withdraws the interface.
    pub(super) fn withdraw(&mut self) -> Result<Withdrawal, Misuse> {
        match self.state {
            State::Live | State::Suspended => {
                self.state = State::Dropping;
                Ok(Withdrawal::Send)
            }
            // WITHDRAW of a refused interface would be a violation, so the answer has to come
            // first.
            State::Renewing => {
                self.state = State::WithdrawalQueued;
                Ok(Withdrawal::Wait)
            }
            State::Queued | State::Dormant => Ok(Withdrawal::Forget),
            State::Declaring | State::WithdrawalQueued | State::Dropping => Err(Misuse::NotLive),
        }
    }

    /// WITHDRAWN has come.
    pub(super) fn withdrawn(&self) -> Result<(), Violation> {
        match self.state {
            State::Dropping => Ok(()),
            _ => Err(violation!(UnknownInterface, "SM2-IFC-003")),
        }
    }

    /// The session is over. Returns whether the interface stays.
    //= SM2-NOD-003
    pub(super) fn away(&mut self) -> bool {
        self.state = match self.state {
            State::Queued | State::Declaring => State::Queued,
            State::Dormant | State::Renewing | State::Live | State::Suspended => State::Dormant,
            State::WithdrawalQueued | State::Dropping => return false,
        };
        self.links
            .retain(|_, (standing, _)| *standing != Standing::Left);
        for (standing, _) in self.links.values_mut() {
            *standing = Standing::Unclaimed;
        }
        true
    }

    /// Removes and returns the links of the Manager with this epoch: it ended them with the earlier
    /// session.
    //= SM2-RES-002, SM2-SES-006
    pub(super) fn forget(&mut self, epoch: u64) -> impl Iterator<Item = LinkId> + use<> {
        let links = core::mem::take(&mut self.links);
        let (over, rest) = links.into_iter().partition(|(link, _)| link.epoch == epoch);
        self.links = rest;
        BTreeMap::into_keys(over)
    }

    /// The links that have to be claimed now.
    //= SM2-RES-002
    pub(super) fn claim(&mut self) -> impl Iterator<Item = (LinkId, Link)> {
        let live = self.state == State::Live;
        let links = self.links.iter_mut().filter(move |_| live);
        links.filter_map(|(&id, (standing, link))| {
            let unclaimed = *standing == Standing::Unclaimed;
            *standing = if unclaimed {
                Standing::Known
            } else {
                *standing
            };
            unclaimed.then_some((id, *link))
        })
    }

    /// LINK has come. Returns whether the link is to be used: a LINK that crossed WITHDRAW is
    /// legal, but has no effect.
    //= SM2-LNK-004, SM2-IFC-004
    pub(super) fn link(
        &mut self,
        id: LinkId,
        link: Link,
        peer: &LinkPeer,
    ) -> Result<bool, Violation> {
        if !matches!(self.state, State::Live | State::Dropping) {
            return Err(violation!(UnknownInterface, "SM2-LNK-004"));
        }
        if self.links.contains_key(&id) {
            return Err(violation!(BadLinkId, "SM2-LNK-004"));
        }
        let asked = match_contracts(&self.contract, &peer.contract)
            .map_err(|_| violation!(BadLink, "SM2-LNK-004"))?;
        // Only sealing may go beyond what both sides ask for, because the Manager has reasons of
        // its own.
        let qos = link.qos;
        let fits = asked.reliable == qos.reliable && asked.sealed <= qos.sealed;
        if !fits || link.version != VERSION || self.links.len() == LINKS_MAX {
            return Err(violation!(BadLink, "SM2-LNK-004"));
        }
        self.links.insert(id, (Standing::Known, link));
        Ok(self.state == State::Live)
    }

    /// UNLINK has come.
    //= SM2-LNK-003, SM2-IFC-004
    pub(super) fn unlink(&mut self, link: LinkId) -> Result<Answer, Violation> {
        if !self.is_kept() {
            return Err(violation!(UnknownInterface, "SM2-LNK-003"));
        }
        let standing = self.links.get(&link).map(|(standing, _)| *standing);
        let answer = match (standing, self.state) {
            (None | Some(Standing::Unclaimed), _) => {
                return Err(violation!(UnknownLink, "SM2-LNK-003"));
            }
            (Some(Standing::Known), State::Live | State::Suspended) => Answer::Unlinked,
            (Some(Standing::Left), State::Live | State::Suspended) => Answer::Crossed,
            (Some(_), _) => Answer::Nothing,
        };
        self.links.remove(&link);
        Ok(answer)
    }

    /// The machine of a link has ended. Returns whether UNLINKED has to go out. It must not if the
    /// Manager said farewell first or does not know the link, nor after WITHDRAW.
    //= SM2-LNK-009, SM2-IFC-004
    pub(super) fn close_link(&mut self, link: LinkId) -> bool {
        match self.links.get_mut(&link) {
            Some((standing @ Standing::Known, _))
                if matches!(self.state, State::Live | State::Suspended) =>
            {
                *standing = Standing::Left;
                true
            }
            Some((Standing::Unclaimed, _)) => {
                self.links.remove(&link);
                false
            }
            _ => false,
        }
    }
}
