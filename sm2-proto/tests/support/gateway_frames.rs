//! Random legal frames of gateways.

use proptest::{collection::vec, prelude::*, sample::select};
use sm2_proto::{
    Name, TypeId,
    gateway::{AskId, Frame, GatewayId, Hop, OfferId, Subject, SubjectKind, Verdict},
    limits::HOPS_MAX,
};

use crate::support::contracts::name;

fn any_name() -> impl Strategy<Value = Name> {
    "[a-zA-Z0-9_-]{1,9}(/[a-z0-9]{1,5}){0,3}".prop_map(|it| name(&it))
}

fn any_type() -> impl Strategy<Value = TypeId> {
    (any_name(), any::<u64>()).prop_map(|(name, hash)| TypeId { name, hash })
}

pub(crate) fn any_frame() -> impl Strategy<Value = Frame> {
    let topic = (any_name(), any_type(), any::<bool>(), 0_u16..=1_024);
    let topic = topic.prop_map(|(name, data, reliable, latched)| Subject::Topic {
        name,
        data,
        reliable,
        latched,
    });
    let service =
        (any_name(), any_type(), any_type()).prop_map(|(name, request, reply)| Subject::Service {
            name,
            request,
            reply,
        });
    let subject = prop_oneof![topic, service];
    let path = vec(any::<u64>(), 1..=HOPS_MAX).prop_map(|epochs| {
        let hop = |(gateway, epoch)| Hop {
            gateway: GatewayId([gateway; 32]),
            epoch,
        };
        (0..).zip(epochs).map(hop).collect::<Vec<_>>()
    });
    let verdicts = vec![Verdict::Offered, Verdict::Denied, Verdict::Absent];
    let kinds = vec![SubjectKind::Topic, SubjectKind::Service];
    prop_oneof![
        (any::<(u16, u16, u64)>(), any_name()).prop_map(
            |((min_version, max_version, epoch), name)| Frame::Hello {
                min_version,
                max_version,
                epoch,
                name
            }
        ),
        (any::<u64>(), subject, path).prop_map(|(offer, subject, path)| Frame::Offer {
            offer: OfferId(offer),
            subject,
            path
        }),
        any::<u64>().prop_map(|offer| Frame::Unoffer {
            offer: OfferId(offer)
        }),
        any::<u64>().prop_map(|offer| Frame::Unoffered {
            offer: OfferId(offer)
        }),
        (any::<u64>(), 1_u16..=1_024).prop_map(|(offer, depth)| Frame::Want {
            offer: OfferId(offer),
            depth
        }),
        any::<u64>().prop_map(|offer| Frame::Unwant {
            offer: OfferId(offer)
        }),
        any::<u64>().prop_map(|offer| Frame::Unwanted {
            offer: OfferId(offer)
        }),
        (any::<u64>(), select(kinds), any_name()).prop_map(|(ask, kind, name)| Frame::Ask {
            ask: AskId(ask),
            kind,
            name
        }),
        (any::<u64>(), select(verdicts)).prop_map(|(ask, verdict)| Frame::Answer {
            ask: AskId(ask),
            verdict
        }),
    ]
}
