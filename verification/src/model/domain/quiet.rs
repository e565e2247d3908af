//! The properties that hold in every moment, and those that hold when no action is left.

use std::collections::BTreeMap;

use sm2_proto::{
    Contract, Datagram, EntityId, LinkId, Machine,
    control::{Item, Page, UnlinkedReason},
    domain::{Ask, Domain, Mirror},
    manager::{self, Manager},
    node::{self, Node},
};

use super::{
    super::{Failure, Property},
    Action, Budget, Fault, Scope,
    books::Books,
    matching::{LinkQos, qos},
    world::{End, Socket, World},
};

impl World {
    /// Checks this moment, in which `actions` are possible. Returns whether it is quiet.
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
    pub fn settled(mut self, scope: &Scope) -> Result<Self, Failure> {
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
        let entities: Vec<_> = ends.iter().collect();
        for (index, (one, (_, ours))) in entities.iter().enumerate() {
            for (other, (_, theirs)) in &entities[index + 1..] {
                let pair = [**one, **other];
                let same = |it: [End; 2]| it == pair || it == [pair[1], pair[0]];
                let links = self.pairs.values().filter(|it| same(it.ends)).count();
                let wanted = usize::from(qos(ours, theirs).is_some());
                if links != wanted && !(links == 0 && self.broken.contains(&pair)) {
                    let what = format!("{pair:?} has {links} links, not {wanted}");
                    return fail(Property::Converges, what);
                }
            }
        }
        self.check_mirror(scope, &ends)
    }

    /// The declared interfaces, with their numbers at the Manager.
    fn ends<'a>(
        &self,
        scope: &'a Scope,
    ) -> Result<BTreeMap<End, (EntityId, &'a Contract)>, Failure> {
        let mut ends = BTreeMap::new();
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

    //= SM2-IFC-007, SM2-WCH-004 model
    fn check_mirror(
        &self,
        scope: &Scope,
        ends: &BTreeMap<End, (EntityId, &Contract)>,
    ) -> Result<(), Failure> {
        let entity_of = |end: &End| ends.get(end).map(|(entity, _)| *entity);
        let mut links: Vec<(LinkId, [EntityId; 2])> = Vec::new();
        for (link, pair) in &self.pairs {
            if let [Some(one), Some(other)] = pair.ends.each_ref().map(entity_of) {
                let mut entities = [one, other];
                entities.sort_unstable();
                links.push((*link, entities));
            }
        }
        let mut interfaces: Vec<_> = ends.values().map(|it| (it.0, it.1.clone())).collect();
        interfaces.sort_unstable_by_key(|(entity, _)| *entity);
        let mut shown = (Vec::new(), Vec::new(), 0);
        for item in self.look(scope)?.items() {
            match item {
                Item::Domain { .. } => {}
                Item::Node { resuming, .. } if !resuming => shown.2 += 1,
                Item::Interface { entity, contract } => shown.0.push((*entity, contract.clone())),
                Item::Link {
                    link,
                    offering,
                    demanding,
                    reliable,
                    sealed,
                    ..
                } => {
                    let contract = |entity: &EntityId| {
                        let mut all = ends.values().filter(|(it, _)| it == entity);
                        all.next().map(|(_, contract)| *contract)
                    };
                    let both = contract(offering).zip(contract(demanding));
                    let wanted = both.and_then(|(one, other)| qos(one, other));
                    let (reliable, sealed) = (*reliable, *sealed);
                    if wanted != Some(LinkQos { reliable, sealed }) {
                        return fail(Property::MirrorIsExact, format!("{item:?} is shown"));
                    }
                    let mut entities = [*offering, *demanding];
                    entities.sort_unstable();
                    shown.1.push((*link, entities));
                }
                Item::Unlinked {
                    offering,
                    demanding,
                    reason: UnlinkedReason::Ended { .. },
                } if self.is_broken(*offering, *demanding, entity_of) => {}
                other => return fail(Property::MirrorIsExact, format!("{other:?} is shown")),
            }
        }
        let exact = shown == (interfaces, links, self.programs.len());
        if exact {
            return Ok(());
        }
        fail(Property::MirrorIsExact, format!("shown are {shown:?}"))
    }

    fn is_broken(
        &self,
        offering: EntityId,
        demanding: EntityId,
        entity_of: impl Fn(&End) -> Option<EntityId>,
    ) -> bool {
        let wanted = [Some(offering), Some(demanding)];
        self.broken.iter().any(|ends| {
            let mut entities = ends.each_ref().map(&entity_of);
            let straight = entities == wanted;
            entities.reverse();
            straight || entities == wanted
        })
    }

    /// Reads the domain as the first node would. Does not change the moment.
    fn look(&self, scope: &Scope) -> Result<Domain, Failure> {
        let unread = || Failure {
            property: Property::MirrorIsExact,
            what: "the domain cannot be read".into(),
        };
        let mut node: Node = self.programs[0].node.clone();
        let mut manager = Manager::clone(self.manager.as_ref().ok_or_else(unread)?.machine());
        let session = node.id().ok_or_else(unread)?;
        let mut mirror = Mirror::new();
        while let Some(Ask::Page { after }) = mirror.ask() {
            let asked = node.handle(self.now, node::Input::Query { after });
            asked.map_err(|_| unread())?;
            while let Some(output) = node.poll() {
                let node::Output::Transmit(bytes) = output else {
                    return Err(unread());
                };
                let datagram = Datagram::new(&bytes);
                let input = manager::Input::Datagram { session, datagram };
                manager.handle(self.now, input).map_err(|_| unread())?;
            }
            while let Some(output) = manager.poll() {
                let manager::Output::Send { frame, .. } = output else {
                    return Err(unread());
                };
                let datagram = node::Input::Datagram(Datagram::new(&frame));
                node.handle(self.now, datagram).map_err(|_| unread())?;
            }
            while let Some(output) = node.poll() {
                let node::Output::Page(Page {
                    revision,
                    mut items,
                    next,
                }) = output
                else {
                    return Err(unread());
                };
                if scope.fault == Some(Fault::ItemLost) {
                    items.pop();
                }
                mirror.page(revision, items, next).map_err(|_| unread())?;
            }
        }
        Ok(mirror.into_domain())
    }
}

fn fail<T>(property: Property, what: String) -> Result<T, Failure> {
    Err(Failure { property, what })
}
