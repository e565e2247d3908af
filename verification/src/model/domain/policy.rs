//! The access policy of a domain, which changes while it runs, and what has to follow from it.

use std::{collections::BTreeSet, rc::Rc};

use sm2_proto::{manager::Manager, policy::AccessPolicy};

use super::{
    super::{Failure, Property, fail},
    Restriction, Scope,
    program::{End, Program},
};

/// The policy in force.
#[derive(Clone, Debug, Default, Hash)]
pub(super) struct Policy {
    /// True if the restriction of the scope is the domain's access policy.
    pub(super) restricted: bool,
    /// True if the present Manager got another access policy while it ran.
    pub(super) reloaded: bool,
}

impl Policy {
    /// The access policy of the domain.
    pub(super) fn access(&self, scope: &Scope) -> Option<AccessPolicy> {
        self.restricted.then(|| scope.restriction.policy())
    }

    /// The interfaces that the policy in force is about. Which publisher of a topic stays depends on
    /// the order of their declarations, also at the next Manager.
    pub(super) fn concerned(&self, scope: &Scope, programs: &[Rc<Program>]) -> BTreeSet<End> {
        if self.restricted {
            concerned(scope, programs).collect()
        } else {
            BTreeSet::new()
        }
    }

    /// Whether a link may end soon: the Manager, which applies a policy in parts, has perhaps not
    /// judged one of these interfaces yet.
    pub(super) fn is_undecided(
        &self,
        scope: &Scope,
        programs: &[Rc<Program>],
        manager: Option<&Manager>,
        ends: &[End; 2],
    ) -> bool {
        self.restricted
            && manager.is_some_and(Manager::is_applying_policy)
            && concerned(scope, programs).any(|end| ends.contains(&end))
    }

    /// Once a Manager has applied a policy that it got while it ran, no node that it has welcomed
    /// holds a link that the policy denies.
    //= SM2-ACC-014 model
    pub(super) fn check_applied(
        &self,
        scope: &Scope,
        programs: &[Rc<Program>],
        manager: Option<&Manager>,
    ) -> Result<(), Failure> {
        let is_applied = manager.is_some_and(|it| !it.is_applying_policy());
        if !(self.restricted && self.reloaded && is_applied)
            || scope.restriction != Restriction::NoSubscriber
        {
            return Ok(());
        }
        for (at, life, interface) in concerned(scope, programs) {
            let program = &programs[usize::from(at)];
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
        programs: &[Rc<Program>],
        suspended: &BTreeSet<End>,
    ) -> Result<(), Failure> {
        let concerned: BTreeSet<_> = concerned(scope, programs).collect();
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

/// The interfaces that the restriction is about.
fn concerned(scope: &Scope, programs: &[Rc<Program>]) -> impl Iterator<Item = End> {
    let programs = (0_u8..).zip(programs).zip(&scope.programs);
    programs.flat_map(move |((at, program), contracts)| {
        let interfaces = program.interfaces.iter();
        interfaces
            .filter(|(_, place)| scope.restriction.is_about(&contracts[usize::from(**place)]))
            .map(move |(&interface, _)| (at, program.life, interface))
    })
}
