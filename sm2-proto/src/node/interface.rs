//! One interface of a node and its ends of links (the table in SPEC section 4.3).

use alloc::collections::BTreeMap;

use super::Misuse;
use crate::{Contract, LinkId, Terms, VERSION, Violation, limits::LINKS_MAX, match_contracts};

/// Where an interface stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// DECLARE sent.
    Declaring,
    /// DECLARED received.
    Live,
    /// WITHDRAW sent.
    Dropping,
}

/// Where one end of a link stands (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Farewell {
    /// Neither side has said farewell.
    None,
    /// We have.
    Ours,
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
    links: BTreeMap<LinkId, Farewell>,
}

impl Interface {
    pub(super) const fn new(contract: Contract) -> Self {
        Self {
            contract,
            state: State::Declaring,
            links: BTreeMap::new(),
        }
    }

    pub(super) fn declared(&mut self) {
        self.state = State::Live;
    }

    /// WITHDRAW goes out.
    pub(super) fn withdraw(&mut self) -> Result<(), Misuse> {
        match self.state {
            State::Live => {
                self.state = State::Dropping;
                Ok(())
            }
            State::Declaring | State::Dropping => Err(Misuse::NotLive),
        }
    }

    /// WITHDRAWN came in.
    pub(super) fn withdrawn(&self) -> Result<(), Violation> {
        match self.state {
            State::Dropping => Ok(()),
            State::Declaring | State::Live => Err(Violation::UnknownInterface),
        }
    }

    /// LINK came in. Whether the link is to be used: one that crossed our
    /// WITHDRAW is legal, and over.
    //= SM2-LNK-005, SM2-IFC-004
    pub(super) fn link(
        &mut self,
        link: LinkId,
        version: u16,
        terms: Terms,
        theirs: &Contract,
    ) -> Result<bool, Violation> {
        if self.state == State::Declaring {
            return Err(Violation::UnknownInterface);
        }
        if self.links.contains_key(&link) {
            return Err(Violation::LinkNumber);
        }
        let asked = match_contracts(&self.contract, theirs).map_err(|_| Violation::BadLink)?;
        // The Manager seals for reasons of its own too; no other term is its choice.
        let fits = asked.reliable == terms.reliable && asked.sealed <= terms.sealed;
        if !fits || version != VERSION || self.links.len() == LINKS_MAX {
            return Err(Violation::BadLink);
        }
        self.links.insert(link, Farewell::None);
        Ok(self.state == State::Live)
    }

    /// UNLINK came in.
    //= SM2-LNK-003, SM2-IFC-004
    pub(super) fn unlink(&mut self, link: LinkId) -> Result<Answer, Violation> {
        if self.state == State::Declaring {
            return Err(Violation::UnknownInterface);
        }
        let farewell = self.links.remove(&link).ok_or(Violation::UnknownLink)?;
        match (self.state, farewell) {
            (State::Live, Farewell::None) => Ok(Answer::Unlinked),
            _ => Ok(Answer::Nothing),
        }
    }

    /// Our end of a link is over. Whether UNLINKED has to go out: not if the
    /// Manager said farewell first, nor after WITHDRAW.
    //= SM2-LNK-004, SM2-IFC-004
    pub(super) fn close_link(&mut self, link: LinkId) -> bool {
        let live = self.state == State::Live;
        match self.links.get_mut(&link) {
            Some(farewell @ Farewell::None) if live => {
                *farewell = Farewell::Ours;
                true
            }
            _ => false,
        }
    }
}
