//! The properties that hold in every moment, and those that hold when no action is left.

use sm2_proto::EntityId;

use super::{
    super::{Failure, Property, fail},
    Action, Budget, Scope,
    books::Books,
    matching::qos,
    mirror::{Ends, Oracle, Reader},
    program::End,
    world::{Socket, World},
};

impl World {
    /// Checks this moment, when `actions` are possible. Returns whether it is quiet.
    ///
    /// # Errors
    ///
    /// The first property that does not hold.
    //= SM2-MAT-001, SM2-MAT-002, SM2-MAT-003, SM2-RES-002, SM2-RES-004, SM2-RES-007 model
    pub fn check(&self, scope: &Scope, actions: &[Action]) -> Result<bool, Failure> {
        let mut joined = Vec::new();
        for (link, pair) in &self.pairs {
            if pair.sockets == [Socket::Held; 2] && !pair.doomed {
                let mut ends = pair.ends;
                ends.sort_unstable();
                if joined.contains(&ends) {
                    return fail(Property::OneLinkPerPair, format!("{link} is another link"));
                }
                joined.push(ends);
            }
        }
        let manager = self.manager.as_ref().map(|it| it.machine());
        (self.policy).check_applied(scope, &self.programs, manager)?;
        scope.check_room(&self.programs)?;
        if actions.iter().any(Action::goes_on) {
            return Ok(false);
        }
        self.check_quiet(scope)?;
        Ok(true)
    }

    /// Returns this moment after all pending actions and declarations, in one possible order.
    ///
    /// # Errors
    ///
    /// The property that was broken on the way, or that does not hold at the end.
    pub fn linked(mut self, scope: &Scope) -> Result<Self, Failure> {
        self.budget = Budget::default();
        while let Some(&action) = self.actions(scope).first() {
            self.check(scope, &[action])?;
            self = self.step(scope, action)?;
        }
        self.check(scope, &[])?;
        Ok(self)
    }

    fn check_quiet(&self, scope: &Scope) -> Result<(), Failure> {
        let ends = self.ends(scope)?;
        for (link, pair) in &self.pairs {
            let known = pair.ends.iter().all(|end| ends.contains_key(end));
            if pair.sockets != [Socket::Held; 2] || !known {
                return fail(Property::Converges, format!("{link} has one end: {pair:?}"));
            }
        }
        for program in &self.programs {
            let books = program.connection.iter().map(|it| &it.books);
            if let Some(end) = books.clone().find_map(Books::half_said) {
                let what = format!("{end:?} lacks a farewell, or nobody read it");
                return fail(Property::OneFarewell, what);
            }
            if !books.flat_map(Books::ends).eq(&program.links) {
                let what = "a node and its Manager know different links";
                return fail(Property::Converges, what.into());
            }
        }
        let manager = self.manager.as_ref().map(|it| it.machine());
        let domain = Reader::new(self.now, &self.programs[0].node, manager)?.read(scope)?;
        let oracle = Oracle {
            scope,
            ends: &ends,
            programs: &self.programs,
            pairs: &self.pairs,
            broken: &self.broken,
        };
        let shown = oracle.shown_in(&domain)?;
        (self.policy).check_suspended(scope, &self.programs, &shown.suspended)?;
        let entities: Vec<_> = ends.iter().collect();
        for (index, (one, (_, ours))) in entities.iter().enumerate() {
            for (other, (_, theirs)) in &entities[index + 1..] {
                let pair = [**one, **other];
                let same = |it: [End; 2]| it == pair || it == [pair[1], pair[0]];
                let links = self.pairs.values().filter(|it| same(it.ends)).count();
                let live = pair.iter().all(|it| !shown.suspended.contains(it));
                let wanted = usize::from(live && qos(ours, theirs).is_some());
                let may_lack = self.broken.contains(&pair) || shown.waiting.contains(&pair);
                if links != wanted && !(links == 0 && may_lack) {
                    let what = format!("{pair:?} has {links} links, not {wanted}");
                    return fail(Property::Converges, what);
                }
            }
        }
        scope.check_waiting(&self.programs, &shown.waiting)?;
        oracle.check_all_shown(&shown)
    }

    /// The declared interfaces, with their numbers at the Manager.
    fn ends<'a>(&self, scope: &'a Scope) -> Result<Ends<'a>, Failure> {
        let mut ends = Ends::new();
        for (at, program) in (0_u8..).zip(&self.programs) {
            let (true, Some(node)) = (program.node.is_ready(), program.node.id()) else {
                return fail(Property::Converges, format!("node {at} is never ready"));
            };
            if scope.eager && !program.undeclared.is_empty() {
                return fail(Property::Converges, format!("node {at} has not declared"));
            }
            for (&interface, &contract) in &program.interfaces {
                let contract = &scope.programs[usize::from(at)][usize::from(contract)];
                let entity = EntityId { node, interface };
                ends.insert((at, program.life, interface), (entity, contract));
            }
        }
        Ok(ends)
    }
}
