//! Subscribers that are linked with no publisher, although one may have been meant.

use sm2_node::explain::{Finding, NearName, Verdict, nearest};
use sm2_proto::{Contract, EntityId, Kind, TypeId, domain::InterfaceView};

use super::check::Check;
use crate::view::View;

/// The greatest number of subscribers that are looked at.
const SUBSCRIBERS_MAX: usize = 64;

/// The subscribers without a link whose topic has a publisher, or whose topic has a name like that of a publisher to
/// which nobody listens. A subscriber may also be the first of its topic, so the others are not reported.
pub(super) fn unlinked(view: &View<'_>) -> Check {
    const CHECK: &str = "unlinked subscribers";
    let is_subscriber = |it: &InterfaceView<'_>| it.contract.kind() == Kind::Subscriber;
    let is_unlinked = |it: &InterfaceView<'_>| view.links_of(it.entity).is_empty();
    let unlinked = view.granted().filter(is_subscriber).filter(is_unlinked);
    let found = unlinked
        .take(SUBSCRIBERS_MAX)
        .filter_map(|it| meant(view, it));
    let found: Vec<_> = found.collect();
    let Some(first) = found.first() else {
        return Check::ok(CHECK, "none that a publisher may be meant for");
    };
    let advice = format!(
        "see `sm2 why {} {}`",
        view.title(first.one.entity),
        view.title(first.other.entity)
    );
    // The first line of a verdict says what is wrong.
    let reason = |it: &Verdict| {
        let text = it.to_string();
        let first = text.lines().next().unwrap_or_default();
        first.trim_end_matches('.').to_owned()
    };
    let reasons: Vec<_> = found.iter().map(reason).collect();
    Check::warn(CHECK, reasons.join("; "), advice)
}

/// Why a subscriber is not linked with the publisher that may be meant.
fn meant(view: &View<'_>, subscriber: InterfaceView<'_>) -> Option<Verdict> {
    let mut near = nearest(view.domain, subscriber.entity).into_iter();
    near.find_map(|near| {
        let is_meant = match near.verdict.finding {
            Finding::Reliability | Finding::Deadline { .. } | Finding::Liveliness { .. } => true,
            Finding::Names { near: Some(name) } => {
                // `front/scan` and `front/image` are two topics.
                let is_similar = name != NearName::Leading;
                let is_unlinked = view.links_of(near.entity).is_empty();
                is_similar && is_unlinked && has_same_type(view, near.entity, subscriber.entity)
            }
            _ => false,
        };
        is_meant.then_some(near.verdict)
    })
}

/// Whether two interfaces of topics have the same type, or one of them states none.
fn has_same_type(view: &View<'_>, one: EntityId, other: EntityId) -> bool {
    let data = |entity| match view.domain.interface(entity)?.contract {
        Contract::Publisher { data, .. } => Some(data),
        Contract::Subscriber { data, .. } => data.as_ref(),
        _ => None,
    };
    let types: [Option<&TypeId>; 2] = [data(one), data(other)];
    !matches!(types, [Some(one), Some(other)] if one != other)
}
