//! Short constructors of names and contracts.
#![allow(dead_code, reason = "each test uses a part")]

use sm2_proto::{Contract, DemandedQos, Name, OfferedQos, Period, ServiceQos, TypeId};

pub(crate) fn name(text: &str) -> Name {
    Name::new(text).expect("the test wrote a legal name")
}

pub(crate) fn data(text: &str) -> TypeId {
    TypeId {
        name: name(text),
        hash: 7,
    }
}

pub(crate) fn publisher(topic: &str, data: &TypeId) -> Contract {
    publisher_with(topic, data, true, false)
}

pub(crate) fn publisher_with(topic: &str, data: &TypeId, reliable: bool, sealed: bool) -> Contract {
    Contract::Publisher {
        topic: name(topic),
        data: data.clone(),
        offer: OfferedQos {
            reliable,
            sealed,
            ..OfferedQos::new(4)
        },
    }
}

pub(crate) fn scan() -> Contract {
    publisher("scan", &data("Scan"))
}

/// Without a type, the subscriber takes every type.
pub(crate) fn subscriber(topic: &str, data: Option<&TypeId>) -> Contract {
    subscriber_with(topic, data, false, false)
}

pub(crate) fn subscriber_with(
    topic: &str,
    data: Option<&TypeId>,
    reliable: bool,
    sealed: bool,
) -> Contract {
    Contract::Subscriber {
        topic: name(topic),
        data: data.cloned(),
        demand: DemandedQos {
            reliable,
            sealed,
            ..DemandedQos::new(4, 2)
        },
    }
}

/// The contract of a publisher or subscriber with this deadline, in nanoseconds.
pub(crate) fn with_deadline(mut contract: Contract, deadline: u64) -> Contract {
    match &mut contract {
        Contract::Publisher { offer, .. } => offer.deadline = Period(deadline),
        Contract::Subscriber { demand, .. } => demand.deadline = Period(deadline),
        Contract::Server { .. } | Contract::Client { .. } => {}
    }
    contract
}

pub(crate) fn with_lease(mut contract: Contract, lease: u64) -> Contract {
    match &mut contract {
        Contract::Publisher { offer, .. } => offer.lease = Period(lease),
        Contract::Subscriber { demand, .. } => demand.lease = Period(lease),
        Contract::Server { .. } | Contract::Client { .. } => {}
    }
    contract
}

pub(crate) fn server(service: &str, request: &TypeId, reply: &TypeId) -> Contract {
    Contract::Server {
        service: name(service),
        request: request.clone(),
        reply: reply.clone(),
        qos: service_qos(false),
    }
}

pub(crate) fn client(service: &str, types: Option<(&TypeId, &TypeId)>) -> Contract {
    Contract::Client {
        service: name(service),
        types: types.map(|(request, reply)| (request.clone(), reply.clone())),
        qos: service_qos(false),
    }
}

pub(crate) fn service_qos(sealed: bool) -> ServiceQos {
    ServiceQos {
        depth: 4,
        max_borrowed: 2,
        sealed,
    }
}
