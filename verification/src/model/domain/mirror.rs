//! The domain as pages show it, compared with what it is.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Contract, Datagram, EntityId, LinkId, Machine,
    control::{Item, Page, UnlinkedReason},
    domain::{Ask, Domain, Mirror},
    manager::{self, Manager},
    node::{self, Node},
};

use super::{
    super::{Failure, Property, fail},
    Fault, Scope,
    matching::{LinkQos, qos},
    world::{End, World},
};

/// The declared interfaces, with their numbers at the Manager.
pub(super) type Ends<'a> = BTreeMap<End, (EntityId, &'a Contract)>;

/// The contents of pages.
#[derive(Debug, Default)]
pub(super) struct Shown {
    nodes: usize,
    /// The live interfaces.
    interfaces: Vec<(EntityId, Contract)>,
    /// The interfaces that the access policy suspends.
    pub(super) suspended: BTreeSet<End>,
    links: Vec<(LinkId, [EntityId; 2])>,
    /// The pairs whose links wait for room.
    pub(super) waiting: BTreeSet<[End; 2]>,
}

impl World {
    /// Reads all pages. Each item belongs to the domain.
    //= SM2-IFC-007, SM2-WCH-004 model
    pub(super) fn shown(&self, scope: &Scope, ends: &Ends<'_>) -> Result<Shown, Failure> {
        let entity_of = |end: &End| ends.get(end).map(|(entity, _)| *entity);
        let found = |entity: &EntityId| {
            let mut all = ends.iter().filter(|(_, (it, _))| it == entity);
            all.next().map(|(end, (_, contract))| (*end, *contract))
        };
        let mut shown = Shown::default();
        for item in self.look(scope)?.items() {
            match item {
                Item::Domain { .. } => {}
                Item::Node { resuming, .. } if !resuming => shown.nodes += 1,
                Item::Interface { entity, contract } => {
                    shown.interfaces.push((*entity, contract.clone()));
                }
                Item::Refusal {
                    entity, contract, ..
                } => match found(entity) {
                    Some((end, declared)) if declared == contract => {
                        shown.suspended.insert(end);
                    }
                    None if self.was_refused(scope, *entity, contract) => {}
                    _ => return fail(Property::MirrorIsExact, format!("{item:?} is shown")),
                },
                Item::Link {
                    link,
                    offering,
                    demanding,
                    reliable,
                    sealed,
                    ..
                } => {
                    let both = found(offering).zip(found(demanding));
                    let wanted = both.and_then(|((_, one), (_, other))| qos(one, other));
                    let (reliable, sealed) = (*reliable, *sealed);
                    if wanted != Some(LinkQos { reliable, sealed }) {
                        return fail(Property::MirrorIsExact, format!("{item:?} is shown"));
                    }
                    let mut entities = [*offering, *demanding];
                    entities.sort_unstable();
                    shown.links.push((*link, entities));
                }
                Item::Waiting {
                    offering,
                    demanding,
                    ..
                } if let Some((one, other)) = found(offering).zip(found(demanding)) => {
                    let mut pair = [one.0, other.0];
                    pair.sort_unstable();
                    shown.waiting.insert(pair);
                }
                Item::Unlinked {
                    offering,
                    demanding,
                    reason: UnlinkedReason::Ended { .. },
                } if self.is_broken(*offering, *demanding, entity_of) => {}
                other => return fail(Property::MirrorIsExact, format!("{other:?} is shown")),
            }
        }
        Ok(shown)
    }

    /// Checks that all of the domain is shown.
    pub(super) fn check_mirror(&self, ends: &Ends<'_>, shown: &Shown) -> Result<(), Failure> {
        let entity_of = |end: &End| ends.get(end).map(|(entity, _)| *entity);
        let mut links: Vec<(LinkId, [EntityId; 2])> = Vec::new();
        for (link, pair) in &self.pairs {
            if let [Some(one), Some(other)] = pair.ends.each_ref().map(entity_of) {
                let mut entities = [one, other];
                entities.sort_unstable();
                links.push((*link, entities));
            }
        }
        let live = ends
            .iter()
            .filter(|(end, _)| !shown.suspended.contains(end));
        let mut interfaces: Vec<_> = live.map(|(_, it)| (it.0, it.1.clone())).collect();
        interfaces.sort_unstable_by_key(|(entity, _)| *entity);
        if (shown.nodes, &shown.interfaces, &shown.links)
            == (self.programs.len(), &interfaces, &links)
        {
            return Ok(());
        }
        fail(Property::MirrorIsExact, format!("shown are {shown:?}"))
    }

    /// Whether a program gave up this contract, after the Manager had refused it.
    fn was_refused(&self, scope: &Scope, entity: EntityId, contract: &Contract) -> bool {
        let programs = self.programs.iter().zip(&scope.programs);
        let mut own = programs.filter(|(program, _)| program.node.id() == Some(entity.node));
        own.any(|(program, contracts)| {
            let mut refused = program.refused.iter();
            refused.any(|place| contracts.get(usize::from(*place)) == Some(contract))
        })
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
