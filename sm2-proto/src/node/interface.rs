//! One interface of a node and its ends of links (the tables in SPEC sections 4.3 and 11).

#[cfg(any(kani, test))]
pub(super) mod proofs;

use alloc::collections::BTreeMap;

use super::Misuse;
use crate::{
    Contract, LinkId, LinkKey, LinkQos, VERSION, Violation, control::Peer, limits::LINKS_MAX,
    match_contracts,
};

/// Where an interface stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// Never answered; its DECLARE goes out with CLAIMED.
    Queued,
    /// DECLARE sent, for the first time as far as we know.
    Declaring,
    /// DECLARED received in an earlier session, and not in this one.
    Dormant,
    /// DECLARE sent again.
    Renewing,
    /// As *renewing*, and to be withdrawn as soon as that is answered.
    Doomed,
    /// DECLARED received in this session.
    Live,
    /// WITHDRAW sent.
    Dropping,
}

/// Where one end of a link stands (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Standing {
    /// Made in an earlier session; this one's Manager does not know of it from us.
    Unclaimed,
    /// Made or claimed in this session; neither side has said farewell.
    Known,
    /// We have said farewell.
    Left,
}

/// One end of a link: what LINK said of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Link {
    pub(super) key: LinkKey,
    pub(super) version: u16,
    pub(super) qos: LinkQos,
}

/// What an answer to DECLARE leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answered {
    /// The program's own DECLARE: it hears of it.
    First,
    /// A renewed one.
    Renewed,
    /// A renewed one of an interface that the program gave up meanwhile.
    Doomed,
}

/// What withdrawing leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Withdrawal {
    /// WITHDRAW has to go out.
    Send,
    /// Nothing until the Manager has answered.
    Wait,
    /// The Manager does not have the interface: it is gone.
    Forget,
}

/// What UNLINK has to be answered with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// UNLINKED: the Manager said farewell first.
    Unlinked,
    /// Nothing: we did, or the interface is being dropped.
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

    /// Whether its DECLARE has to go out with CLAIMED; if so, it does.
    pub(super) fn declare(&mut self) -> Option<&Contract> {
        self.step(State::Queued, State::Declaring)
    }

    /// Whether its DECLARE has to go out again with WELCOME; if so, it does.
    //= SM2-RES-002, SM2-RES-009
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

    /// DECLARED came in.
    pub(super) fn declared(&mut self) -> Result<Answered, Violation> {
        let (state, answered) = match self.state {
            State::Declaring => (State::Live, Answered::First),
            State::Renewing => (State::Live, Answered::Renewed),
            State::Doomed => (State::Dropping, Answered::Doomed),
            _ => return Err(violation!(UnknownInterface, "SM2-IFC-002")),
        };
        self.state = state;
        Ok(answered)
    }

    /// DECLARE_REFUSED came in. Only a renewed interface lives on.
    //= SM2-RES-009
    pub(super) fn refused(&mut self) -> Result<Answered, Violation> {
        match self.state {
            State::Declaring => Ok(Answered::First),
            State::Doomed => Ok(Answered::Doomed),
            State::Renewing => {
                self.state = State::Dormant;
                Ok(Answered::Renewed)
            }
            _ => Err(violation!(UnknownInterface, "SM2-IFC-002")),
        }
    }

    /// The program gives the interface up.
    pub(super) fn withdraw(&mut self) -> Result<Withdrawal, Misuse> {
        match self.state {
            State::Live => {
                self.state = State::Dropping;
                Ok(Withdrawal::Send)
            }
            // WITHDRAW of a refused interface would be a violation: first the answer.
            State::Renewing => {
                self.state = State::Doomed;
                Ok(Withdrawal::Wait)
            }
            State::Queued | State::Dormant => Ok(Withdrawal::Forget),
            State::Declaring | State::Doomed | State::Dropping => Err(Misuse::NotLive),
        }
    }

    /// WITHDRAWN came in.
    pub(super) fn withdrawn(&self) -> Result<(), Violation> {
        match self.state {
            State::Dropping => Ok(()),
            _ => Err(violation!(UnknownInterface, "SM2-IFC-003")),
        }
    }

    /// The session is over. Whether the interface lives on.
    //= SM2-NOD-003
    pub(super) fn away(&mut self) -> bool {
        self.state = match self.state {
            State::Queued | State::Declaring => State::Queued,
            State::Dormant | State::Renewing | State::Live => State::Dormant,
            State::Doomed | State::Dropping => return false,
        };
        self.links
            .retain(|_, (standing, _)| *standing != Standing::Left);
        for (standing, _) in self.links.values_mut() {
            *standing = Standing::Unclaimed;
        }
        true
    }

    /// A Manager welcomed us. Its own links of earlier sessions are over: these.
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

    /// LINK came in. Whether the link is to be used: one that crossed our
    /// WITHDRAW is legal, and over.
    //= SM2-LNK-005, SM2-IFC-004
    pub(super) fn link(&mut self, id: LinkId, link: Link, peer: &Peer) -> Result<bool, Violation> {
        if !self.is_declared() {
            return Err(violation!(UnknownInterface, "SM2-LNK-005"));
        }
        if self.links.contains_key(&id) {
            return Err(violation!(LinkNumber, "SM2-LNK-005"));
        }
        let asked = match_contracts(&self.contract, &peer.contract)
            .map_err(|_| violation!(BadLink, "SM2-LNK-005"))?;
        // The Manager seals for reasons of its own too; no other term is its choice.
        let qos = link.qos;
        let fits = asked.reliable == qos.reliable && asked.sealed <= qos.sealed;
        if !fits || link.version != VERSION || self.links.len() == LINKS_MAX {
            return Err(violation!(BadLink, "SM2-LNK-005"));
        }
        self.links.insert(id, (Standing::Known, link));
        Ok(self.state == State::Live)
    }

    /// UNLINK came in.
    //= SM2-LNK-003, SM2-IFC-004
    pub(super) fn unlink(&mut self, link: LinkId) -> Result<Answer, Violation> {
        if !self.is_declared() {
            return Err(violation!(UnknownInterface, "SM2-LNK-003"));
        }
        let standing = self.links.get(&link).map(|(standing, _)| *standing);
        let answer = match (standing, self.state) {
            (None | Some(Standing::Unclaimed), _) => {
                return Err(violation!(UnknownLink, "SM2-LNK-003"));
            }
            (Some(Standing::Known), State::Live) => Answer::Unlinked,
            (Some(_), _) => Answer::Nothing,
        };
        self.links.remove(&link);
        Ok(answer)
    }

    /// Our end of a link is over. Whether UNLINKED has to go out: not if the
    /// Manager said farewell first or does not know of the link, nor after WITHDRAW.
    //= SM2-LNK-004, SM2-IFC-004
    pub(super) fn close_link(&mut self, link: LinkId) -> bool {
        match self.links.get_mut(&link) {
            Some((standing @ Standing::Known, _)) if self.state == State::Live => {
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

    /// Whether the Manager may speak of the interface's links.
    const fn is_declared(&self) -> bool {
        matches!(self.state, State::Live | State::Dropping)
    }
}
