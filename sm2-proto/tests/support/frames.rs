//! Any control frame that SPEC allows.
#![allow(dead_code, reason = "each test uses a part")]

use proptest::{
    collection::vec,
    option,
    prelude::*,
    strategy::{BoxedStrategy, Union},
};
use sm2_proto::{
    Code, Contract, Demand, InterfaceId, LinkId, Name, NodeId, Offer, Quota, Refusal, ServiceQos,
    TypeId,
    control::{Cursor, Item, Peer, ToManager, ToNode},
};

/// Numbers of every length on the wire.
fn number() -> impl Strategy<Value = u64> + Clone {
    (any::<u64>(), 0..64_u32).prop_map(|(number, shift)| number >> shift)
}

pub(crate) fn names() -> impl Strategy<Value = Name> + Clone {
    let text = prop_oneof![
        8 => "[A-Za-z0-9_-]{1,9}(/[A-Za-z0-9_-]{1,9}){0,3}",
        1 => "[a-z]{253,255}",
    ];
    text.prop_map(|text| Name::new(&text).expect("the pattern is the grammar"))
}

fn types() -> impl Strategy<Value = TypeId> + Clone {
    (names(), number()).prop_map(|(name, hash)| TypeId { name, hash })
}

fn interfaces() -> impl Strategy<Value = InterfaceId> + Clone {
    number().prop_map(InterfaceId)
}

fn nodes() -> impl Strategy<Value = NodeId> + Clone {
    number().prop_map(NodeId)
}

fn links() -> impl Strategy<Value = LinkId> {
    (number(), number()).prop_map(|(epoch, serial)| LinkId { epoch, serial })
}

fn cursors() -> impl Strategy<Value = Cursor> {
    (nodes(), interfaces()).prop_map(|(node, interface)| Cursor { node, interface })
}

fn codes() -> impl Strategy<Value = Code> {
    any::<u16>().prop_map(Code)
}

fn service_qos() -> impl Strategy<Value = ServiceQos> {
    (1..=1_024_u16, 1..=1_024_u16, any::<bool>()).prop_map(|(depth, max_borrowed, sealed)| {
        ServiceQos {
            depth,
            max_borrowed,
            sealed,
        }
    })
}

pub(crate) fn contracts() -> impl Strategy<Value = Contract> {
    let flags = || (any::<bool>(), any::<bool>());
    let publisher = (names(), types(), 1..=1_024_u16, 0..=1_024_u16, flags());
    let subscriber = (
        names(),
        option::of(types()),
        1..=1_024_u16,
        1..=1_024_u16,
        flags(),
    );
    prop_oneof![
        publisher.prop_map(|(topic, data, depth, latched, (reliable, sealed))| {
            Contract::Publisher {
                topic,
                data,
                offer: Offer {
                    depth,
                    reliable,
                    latched,
                    sealed,
                },
            }
        }),
        subscriber.prop_map(|(topic, data, depth, max_borrowed, (reliable, sealed))| {
            Contract::Subscriber {
                topic,
                data,
                demand: Demand {
                    depth,
                    reliable,
                    max_borrowed,
                    sealed,
                },
            }
        }),
        (names(), types(), types(), service_qos()).prop_map(|(service, request, reply, qos)| {
            Contract::Server {
                service,
                request,
                reply,
                qos,
            }
        }),
        (names(), option::of((types(), types())), service_qos()).prop_map(
            |(service, types, qos)| Contract::Client {
                service,
                types,
                qos
            }
        ),
    ]
}

fn refusals() -> impl Strategy<Value = Refusal> + Clone {
    let quota = prop_oneof![
        Just(Quota::SessionsPerUser),
        Just(Quota::InterfacesPerSession),
        Just(Quota::InterfacesPerUser),
        Just(Quota::LinksPerSession),
    ];
    prop_oneof![
        Just(Refusal::NameTaken),
        any::<(u16, u16)>().prop_map(|(min, max)| Refusal::Version { min, max }),
        types().prop_map(|theirs| Refusal::TopicType { theirs }),
        (types(), types()).prop_map(|(request, reply)| Refusal::ServiceType { request, reply }),
        (quota, any::<u32>()).prop_map(|(quota, limit)| Refusal::Quota { quota, limit }),
    ]
}

fn items() -> impl Strategy<Value = Item> {
    prop_oneof![
        (nodes(), names(), any::<u32>(), any::<i32>()).prop_map(|(node, name, uid, pid)| {
            Item::Node {
                node,
                name,
                uid,
                pid,
            }
        }),
        (nodes(), interfaces(), contracts(), any::<u32>()).prop_map(
            |(node, interface, contract, links)| Item::Interface {
                node,
                interface,
                contract,
                links,
            }
        ),
    ]
}

pub(crate) fn to_manager() -> Union<BoxedStrategy<ToManager>> {
    let unlinked = (interfaces(), links(), codes());
    Union::new([
        (any::<(u16, u16)>(), names())
            .prop_map(|((min_version, max_version), name)| ToManager::Hello {
                min_version,
                max_version,
                name,
            })
            .boxed(),
        (interfaces(), contracts())
            .prop_map(|(interface, contract)| ToManager::Declare {
                interface,
                contract,
            })
            .boxed(),
        interfaces()
            .prop_map(|interface| ToManager::Withdraw { interface })
            .boxed(),
        unlinked
            .prop_map(|(interface, link, code)| ToManager::Unlinked {
                interface,
                link,
                code,
            })
            .boxed(),
        option::of(cursors())
            .prop_map(|after| ToManager::Query { after })
            .boxed(),
        codes().prop_map(|code| ToManager::Goodbye { code }).boxed(),
    ])
}

pub(crate) fn to_node() -> Union<BoxedStrategy<ToNode>> {
    let peer = (nodes(), names(), interfaces(), contracts()).prop_map(
        |(node, name, interface, contract)| Peer {
            node,
            name,
            interface,
            contract,
        },
    );
    let terms = any::<(u16, bool, bool)>();
    Union::new([
        (any::<u16>(), number(), nodes())
            .prop_map(|(version, epoch, node)| ToNode::Welcome {
                version,
                epoch,
                node,
            })
            .boxed(),
        refusals()
            .prop_map(|reason| ToNode::HelloRefused { reason })
            .boxed(),
        (interfaces(), any::<u32>())
            .prop_map(|(interface, matches)| ToNode::Declared { interface, matches })
            .boxed(),
        (interfaces(), refusals())
            .prop_map(|(interface, reason)| ToNode::DeclareRefused { interface, reason })
            .boxed(),
        (interfaces(), links(), terms, peer)
            .prop_map(
                |(interface, link, (version, reliable, sealed), peer)| ToNode::Link {
                    interface,
                    link,
                    version,
                    reliable,
                    sealed,
                    peer,
                },
            )
            .boxed(),
        (interfaces(), links(), codes())
            .prop_map(|(interface, link, code)| ToNode::Unlink {
                interface,
                link,
                code,
            })
            .boxed(),
        interfaces()
            .prop_map(|interface| ToNode::Withdrawn { interface })
            .boxed(),
        (number(), vec(items(), 0..6), option::of(cursors()))
            .prop_map(|(revision, items, next)| ToNode::Page {
                revision,
                items,
                next,
            })
            .boxed(),
        codes().prop_map(|code| ToNode::Goodbye { code }).boxed(),
    ])
}
