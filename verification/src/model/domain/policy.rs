//! The access policy of a domain, which changes while it runs, and what has to follow from it.

use std::{collections::BTreeSet, sync::Arc};

use sm2_proto::{
    manager::{self, Manager},
    policy::AccessPolicy,
};

use super::{
    super::{Failure, Property, fail},
    Fault, Restriction, Scope,
    world::{End, World},
};

impl World {
    /// The access policy of the domain.
    pub(super) fn access(&self, scope: &Scope) -> Option<AccessPolicy> {
        self.restricted.then(|| scope.restriction.policy())
    }

    /// The domain gets the other policy. The Manager, if there is one, reads it.
    pub(super) fn change_policy(&mut self, scope: &Scope) {
        self.budget.reloads -= 1;
        self.restricted = !self.restricted;
        self.doom_restricted(scope);
        self.reloaded = self.manager.is_some();
        if scope.fault != Some(Fault::PolicyLost) {
            let policy = self.access(scope).map(Arc::new);
            self.feed_manager(scope, manager::Input::SetAccessPolicy(policy), usize::MAX);
        }
    }

    /// Links that the policy in force may end. Which publisher of a topic stays depends on the order
    /// of their declarations, also at the next Manager.
    pub(super) fn doom_restricted(&mut self, scope: &Scope) {
        if self.restricted {
            let concerned: BTreeSet<_> = self.concerned(scope).collect();
            self.doom_all(|end| concerned.contains(end));
        }
    }

    /// Whether a link may end soon: the Manager, which applies a policy in parts, has perhaps not
    /// judged one of these interfaces yet.
    pub(super) fn is_undecided(&self, scope: &Scope, ends: &[End; 2]) -> bool {
        let manager = self.manager.as_ref().map(|it| it.machine());
        self.restricted
            && manager.is_some_and(Manager::is_applying_policy)
            && self.concerned(scope).any(|end| ends.contains(&end))
    }

    /// The interfaces that the restriction is about.
    fn concerned(&self, scope: &Scope) -> impl Iterator<Item = End> {
        let programs = (0_u8..).zip(&self.programs).zip(&scope.programs);
        programs.flat_map(move |((at, program), contracts)| {
            let interfaces = program.interfaces.iter();
            interfaces
                .filter(|(_, place)| scope.restriction.is_about(&contracts[usize::from(**place)]))
                .map(move |(&interface, _)| (at, program.life, interface))
        })
    }

    /// Once a Manager has applied a policy that it got while it ran, no node that it has welcomed
    /// holds a link that the policy denies.
    //= SM2-ACC-014 model
    pub(super) fn check_applied(&self, scope: &Scope) -> Result<(), Failure> {
        let manager = self.manager.as_ref().map(|it| it.machine());
        let is_applied = manager.is_some_and(|it| !it.is_applying_policy());
        if !(self.restricted && self.reloaded && is_applied)
            || scope.restriction != Restriction::NoSubscriber
        {
            return Ok(());
        }
        for (at, life, interface) in self.concerned(scope) {
            let program = &self.programs[usize::from(at)];
            let known = program.connection.as_ref();
            let is_known =
                program.node.is_ready() && known.is_some_and(|it| !it.dead && !it.resuming);
            let link = program.links.iter().find(|(of, _)| *of == interface);
            if let (true, Some((_, link))) = (is_known, link) {
                let what =
                    format!("the policy is applied, and node {at} (process {life}) holds {link}");
                return fail(Property::PolicyHolds, what);
            }
        }
        Ok(())
    }

    /// When all is quiet, exactly those interfaces are suspended that the policy denies.
    //= SM2-ACC-009, SM2-ACC-013 model
    pub(super) fn check_suspended(
        &self,
        scope: &Scope,
        suspended: &BTreeSet<End>,
    ) -> Result<(), Failure> {
        let concerned: BTreeSet<_> = self.concerned(scope).collect();
        let live = concerned.difference(suspended).count();
        // The Manager judges a suspended interface only when the policy changes, so the publisher
        // that was live may be gone.
        let may_be_gone = scope.budget.withdrawals + scope.budget.node_crashes > 0;
        let holds = match self.restricted {
            false => suspended.is_empty(),
            true => {
                suspended.is_subset(&concerned)
                    && scope.restriction.allows(live)
                    && (scope.restriction == Restriction::NoSubscriber || live == 1 || may_be_gone)
            }
        };
        if holds {
            return Ok(());
        }
        let what = format!("suspended are {suspended:?} of {concerned:?}");
        fail(Property::PolicyHolds, what)
    }
}
