//! The rules SM2-MAT-001 and SM2-MAT-003 written from SPEC alone, without the code of the machines:
//! whether two interfaces are to be linked, and with what QoS. The model in `verification/` uses
//! this file as well.

use sm2_proto::Contract;

/// The properties of a link that both sides have to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LinkQos {
    pub(crate) reliable: bool,
    pub(crate) sealed: bool,
}

/// SM2-MAT-001 and, for the two sides alone, SM2-MAT-003.
pub(crate) fn qos(one: &Contract, other: &Contract) -> Option<LinkQos> {
    match (one, other) {
        (
            Contract::Publisher { topic, data, offer },
            Contract::Subscriber {
                topic: theirs,
                data: wanted,
                demand,
            },
        ) => {
            let same = topic == theirs && (wanted.is_none() || wanted.as_ref() == Some(data));
            let qos = LinkQos {
                reliable: demand.reliable,
                sealed: offer.sealed || demand.sealed,
            };
            let reliable = offer.reliable || !demand.reliable;
            let periods = [
                (offer.deadline.get(), demand.deadline.get()),
                (offer.lease.get(), demand.lease.get()),
            ];
            let in_time = periods.iter().all(|it| match it {
                (_, None) => true,
                (None, Some(_)) => false,
                (Some(offered), Some(demanded)) => offered <= demanded,
            });
            (same && reliable && in_time).then_some(qos)
        }
        (
            Contract::Server {
                service,
                request,
                reply,
                qos,
            },
            Contract::Client {
                service: theirs,
                types,
                qos: wanted,
            },
        ) => {
            let same_types = match types {
                None => true,
                Some((a, b)) => a == request && b == reply,
            };
            let qos = LinkQos {
                reliable: true,
                sealed: qos.sealed || wanted.sealed,
            };
            (service == theirs && same_types).then_some(qos)
        }
        (Contract::Subscriber { .. }, Contract::Publisher { .. })
        | (Contract::Client { .. }, Contract::Server { .. }) => qos(other, one),
        _ => None,
    }
}
