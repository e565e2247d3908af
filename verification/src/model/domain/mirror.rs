//! The domain as pages show it, compared with what it is.

use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use sm2_proto::{
    Contract, Datagram, EntityId, Instant, LinkId, Machine,
    control::{Item, Page, UnlinkedReason},
    domain::{Ask, Domain, Mirror},
    manager::{self, Manager},
    node::{self, Node},
};

use super::{
    super::{Failure, Property, fail},
    Fault, Scope,
    matching::{LinkQos, qos},
    program::{End, Program},
    world::Pair,
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

/// The parts of a moment that the pages have to show.
#[derive(Clone, Copy, Debug)]
pub(super) struct Oracle<'a> {
    pub(super) scope: &'a Scope,
    pub(super) ends: &'a Ends<'a>,
    pub(super) programs: &'a [Rc<Program>],
    pub(super) pairs: &'a BTreeMap<LinkId, Pair>,
    /// Pairs that ended their links.
    pub(super) broken: &'a BTreeSet<[End; 2]>,
}

impl Oracle<'_> {
    /// Checks that each item belongs to the domain.
    //= SM2-IFC-007, SM2-WCH-004 model
    pub(super) fn shown_in(self, domain: &Domain) -> Result<Shown, Failure> {
        let found = |entity: &EntityId| {
            let mut all = self.ends.iter().filter(|(_, (it, _))| it == entity);
            all.next().map(|(end, (_, contract))| (*end, *contract))
        };
        let mut shown = Shown::default();
        for item in domain.items() {
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
                    None if self.was_refused(*entity, contract) => {}
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
                } if self.is_broken([*offering, *demanding]) => {}
                other => return fail(Property::MirrorIsExact, format!("{other:?} is shown")),
            }
        }
        Ok(shown)
    }

    /// Checks that all of the domain is shown.
    pub(super) fn check_all_shown(self, shown: &Shown) -> Result<(), Failure> {
        let mut links: Vec<(LinkId, [EntityId; 2])> = Vec::new();
        for (link, pair) in self.pairs {
            if let [Some(one), Some(other)] = self.entities(&pair.ends) {
                let mut entities = [one, other];
                entities.sort_unstable();
                links.push((*link, entities));
            }
        }
        let live = self
            .ends
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
    fn was_refused(self, entity: EntityId, contract: &Contract) -> bool {
        let programs = self.programs.iter().zip(&self.scope.programs);
        let mut own = programs.filter(|(program, _)| program.node.id() == Some(entity.node));
        own.any(|(program, contracts)| {
            let mut refused = program.refused.iter();
            refused.any(|place| contracts.get(usize::from(*place)) == Some(contract))
        })
    }

    /// The numbers of two interfaces at the Manager.
    fn entities(self, ends: &[End; 2]) -> [Option<EntityId>; 2] {
        let entity = |end| self.ends.get(end).map(|(entity, _)| *entity);
        ends.each_ref().map(entity)
    }

    fn is_broken(self, pair: [EntityId; 2]) -> bool {
        let wanted = pair.map(Some);
        self.broken.iter().any(|ends| {
            let mut entities = self.entities(ends);
            let straight = entities == wanted;
            entities.reverse();
            straight || entities == wanted
        })
    }
}

/// A node that reads the domain, and its Manager.
#[derive(Debug)]
pub(super) struct Reader {
    now: Instant,
    node: Node,
    manager: Manager,
}

impl Reader {
    /// Copies the machines, so that reading does not change the moment.
    pub(super) fn new(
        now: Instant,
        node: &Node,
        manager: Option<&Manager>,
    ) -> Result<Self, Failure> {
        Ok(Self {
            now,
            node: node.clone(),
            manager: manager.cloned().ok_or_else(unread)?,
        })
    }

    /// Reads all pages.
    //= SM2-IFC-007 model
    pub(super) fn read(self, scope: &Scope) -> Result<Domain, Failure> {
        let Self {
            now,
            mut node,
            mut manager,
        } = self;
        let session = node.id().ok_or_else(unread)?;
        let mut mirror = Mirror::new();
        while let Some(Ask::Page { after }) = mirror.ask() {
            let asked = node.handle(now, node::Input::Query { after });
            asked.map_err(|_| unread())?;
            while let Some(output) = node.poll() {
                let node::Output::Transmit(bytes) = output else {
                    return Err(unread());
                };
                let datagram = Datagram::new(&bytes);
                let input = manager::Input::Datagram { session, datagram };
                manager.handle(now, input).map_err(|_| unread())?;
            }
            while let Some(output) = manager.poll() {
                let manager::Output::Send { frame, .. } = output else {
                    return Err(unread());
                };
                let datagram = node::Input::Datagram(Datagram::new(&frame));
                node.handle(now, datagram).map_err(|_| unread())?;
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

fn unread() -> Failure {
    Failure {
        property: Property::MirrorIsExact,
        what: "the domain cannot be read".into(),
    }
}
