//! Derives from the items of a domain why two interfaces are linked or not.

use sm2_proto::{
    Contract, EntityId, Kind, Mismatch, Refusal, TypeId,
    control::UnlinkedReason,
    domain::{Domain, InterfaceView, LinkView},
    match_contracts,
};

use super::{Finding, Part, Party, Reliability, Seal, TypePair, Verdict, names};

/// The reason why the two interfaces are linked or not. Their order does not matter.
//= SM2-MAT-001, SM2-MAT-003, SM2-WCH-004
#[must_use]
pub fn why(domain: &Domain, one: EntityId, other: EntityId) -> Verdict {
    let (one, other) = sorted(domain, one, other);
    let finding = match (domain.interface(one), domain.interface(other)) {
        (None, _) => Finding::Unknown { entity: one },
        (_, None) => Finding::Unknown { entity: other },
        (Some(one), Some(other)) => find(domain, &one, &other),
    };
    Verdict {
        one: party(domain, one),
        other: party(domain, other),
        finding,
    }
}

/// The publisher or server first, if exactly one of the two is one; otherwise the lower id.
fn sorted(domain: &Domain, one: EntityId, other: EntityId) -> (EntityId, EntityId) {
    let rank = |entity| {
        let kind = domain.interface(entity).map(|it| it.contract.kind());
        let offers = matches!(kind, Some(Kind::Publisher | Kind::Server));
        (!offers, entity)
    };
    if rank(one) <= rank(other) {
        (one, other)
    } else {
        (other, one)
    }
}

fn find(domain: &Domain, one: &InterfaceView<'_>, other: &InterfaceView<'_>) -> Finding {
    let mut links = domain.links_of(one.entity);
    if let Some(link) = links.find(|it| it.offering == one.entity && it.demanding == other.entity) {
        return linked(domain, link, one, other);
    }
    if let Some(waiting) = waiting(domain, one.entity, other.entity) {
        return waiting;
    }
    let mismatch = match_contracts(one.contract, other.contract).err();
    match mismatch {
        Some(Mismatch::Kind) => return Finding::Kinds,
        Some(Mismatch::Name) => {
            let near = names::near(one.contract.name(), other.contract.name());
            return Finding::Names { near };
        }
        Some(Mismatch::Type | Mismatch::Reliability | Mismatch::Deadline | Mismatch::Lease)
        | None => {}
    }
    // An interface that does not exist cannot be linked, whatever its type.
    let refused = [one, other].into_iter().find_map(|it| {
        let reason = it.refused?.clone();
        Some(Finding::Refused {
            entity: it.entity,
            against: against(domain, it.contract, &reason),
            reason,
        })
    });
    match (refused, mismatch) {
        (Some(refused), _) => refused,
        (None, Some(Mismatch::Type)) => Finding::Types {
            differ: types(one.contract, other.contract),
        },
        (None, Some(Mismatch::Deadline)) => Finding::Deadline {
            offered: one.contract.deadline(),
            demanded: other.contract.deadline(),
        },
        (None, Some(Mismatch::Lease)) => Finding::Liveliness {
            offered: one.contract.lease(),
            demanded: other.contract.lease(),
        },
        (None, Some(_)) => Finding::Reliability,
        (None, None) => obstacle(domain, one.entity, other.entity),
    }
}

/// The reason why the link of two interfaces waits, if it does.
//= SM2-LNK-006, SM2-LNK-007
fn waiting(domain: &Domain, offering: EntityId, demanding: EntityId) -> Option<Finding> {
    let mut waiting = domain.waiting_links();
    let (link, ..) = waiting.find(|&(_, one, other)| (one, other) == (offering, demanding))?;
    let ends = if offering.node == demanding.node {
        2
    } else {
        1
    };
    let full = [offering, demanding].into_iter().find_map(|it| {
        let max_links = domain.node(it.node)?.max_links?;
        let used = domain.known_ends(it.node);
        (used.saturating_add(ends) > max_links).then_some(Finding::NoRoom {
            node: it.node,
            used,
            max_links,
        })
    });
    Some(full.unwrap_or(Finding::Waiting { link }))
}

/// The reason why two interfaces that match are not linked.
fn obstacle(domain: &Domain, offering: EntityId, demanding: EntityId) -> Finding {
    match domain.unlinked_reason(offering, demanding) {
        Some(UnlinkedReason::Ended { code }) => return Finding::Ended { code },
        Some(UnlinkedReason::Quota { node, limit }) => return Finding::Quota { node, limit },
        Some(UnlinkedReason::Descriptors) => return Finding::Descriptors,
        None => {}
    }
    let resuming = |entity: EntityId| domain.node(entity.node).is_some_and(|it| it.resuming);
    let claim = |by, absent| {
        // The claim may wait for the end at the other interface.
        let (link, _) = domain.claims().find(|&(_, entity)| entity == by)?;
        resuming(absent).then_some(Finding::Claimed { link, by })
    };
    if let Some(claimed) = claim(offering, demanding).or_else(|| claim(demanding, offering)) {
        return claimed;
    }
    let mut nodes: Vec<_> = [offering, demanding]
        .into_iter()
        .filter(|&entity| resuming(entity))
        .map(|entity| entity.node)
        .collect();
    nodes.dedup();
    if nodes.is_empty() {
        Finding::Due
    } else {
        Finding::Resuming { nodes }
    }
}

fn linked(
    domain: &Domain,
    link: LinkView,
    one: &InterfaceView<'_>,
    other: &InterfaceView<'_>,
) -> Finding {
    let reliability = match (one.contract, link.reliable) {
        (Contract::Publisher { .. }, true) => Reliability::Demanded,
        (Contract::Publisher { offer, .. }, false) if offer.reliable => Reliability::NotDemanded,
        (Contract::Publisher { .. }, false) => Reliability::NotOffered,
        _ => Reliability::Service,
    };
    Finding::Linked {
        link: link.link,
        version: link.version,
        reliability,
        sealed: if link.sealed {
            seals(domain, one, other)
        } else {
            Vec::new()
        },
    }
}

//= SM2-MAT-003
fn seals(domain: &Domain, one: &InterfaceView<'_>, other: &InterfaceView<'_>) -> Vec<Seal> {
    let asked = [one, other].into_iter().filter(|it| it.contract.sealed());
    let mut seals: Vec<_> = asked.map(|it| Seal::Asked { by: it.entity }).collect();
    let (seal_all, waive_user_boundary) = domain
        .limits()
        .map_or((false, false), |it| (it.seal_all, it.waive_user_boundary));
    if seal_all {
        seals.push(Seal::Policy);
    }
    let uid = |it: &InterfaceView<'_>| domain.node(it.entity.node).map(|it| it.uid);
    if !waive_user_boundary && uid(one) != uid(other) {
        seals.push(Seal::Users);
    }
    if seals.is_empty() {
        seals.push(Seal::Kept);
    }
    seals
}

/// The types that differ, if both interfaces state one.
fn types(offering: &Contract, demanding: &Contract) -> Vec<TypePair> {
    let pair = |part, offered: &TypeId, demanded: &TypeId| {
        (offered != demanded).then(|| TypePair {
            part,
            offered: offered.clone(),
            demanded: demanded.clone(),
            difference: None,
        })
    };
    match (offering, demanding) {
        (
            Contract::Publisher { data, .. },
            Contract::Subscriber {
                data: Some(wanted), ..
            },
        ) => pair(Part::Messages, data, wanted).into_iter().collect(),
        (
            Contract::Server { request, reply, .. },
            Contract::Client {
                types: Some((asks, expects)),
                ..
            },
        ) => {
            let requests = pair(Part::Requests, request, asks);
            let replies = pair(Part::Replies, reply, expects);
            requests.into_iter().chain(replies).collect()
        }
        _ => Vec::new(),
    }
}

/// An interface that states the type which caused the refusal of another one (SM2-IFC-005).
fn against(domain: &Domain, refused: &Contract, reason: &Refusal) -> Option<Party> {
    let states = |contract: &Contract| match (contract, reason) {
        (
            Contract::Publisher { data, .. }
            | Contract::Subscriber {
                data: Some(data), ..
            },
            Refusal::TopicType { theirs },
        ) => data == theirs,
        (
            Contract::Server { request, reply, .. }
            | Contract::Client {
                types: Some((request, reply)),
                ..
            },
            Refusal::ServiceType {
                request: asks,
                reply: expects,
            },
        ) => (request, reply) == (asks, expects),
        _ => false,
    };
    let mut granted = domain.interfaces().filter(|it| it.refused.is_none());
    let found = granted.find(|it| it.contract.name() == refused.name() && states(it.contract))?;
    Some(party(domain, found.entity))
}

/// An interface with its names.
fn party(domain: &Domain, entity: EntityId) -> Party {
    let node = domain.node(entity.node);
    let contract = domain.interface(entity).map(|it| it.contract);
    Party {
        entity,
        node: node.map(|it| it.name.clone()),
        uid: node.map(|it| it.uid),
        kind: contract.map(Contract::kind),
        name: contract.map(|it| it.name().clone()),
    }
}
