//! Any control frame that SPEC allows.
#![allow(dead_code, reason = "each test uses a part")]

use proptest::{
    collection::vec,
    option,
    prelude::*,
    sample::select,
    strategy::{BoxedStrategy, Union},
};
use sm2_proto::{
    Code, Contract, DemandedQos, EntityId, InterfaceId, LinkId, LinkKey, Name, NodeId, OfferedQos,
    Period, Quota, Refusal, ServiceQos, TypeId,
    control::{
        Change, Changes, Item, Key, LinkPeer, Page, PolicyProblem, ReloadOutcome, SchemaText,
        StatedLimit, StatedLimits, ToManager, ToNode, UnlinkedReason,
    },
};

/// Numbers of every length in a frame.
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

fn links() -> impl Strategy<Value = LinkId> + Clone {
    (number(), number()).prop_map(|(epoch, serial)| LinkId { epoch, serial })
}

fn entities() -> impl Strategy<Value = EntityId> + Clone {
    (nodes(), interfaces()).prop_map(|(node, interface)| EntityId { node, interface })
}

fn keys() -> impl Strategy<Value = Key> + Clone {
    prop_oneof![
        Just(Key::Domain),
        entities().prop_map(|entity| Key::Member { entity }),
        (links(), entities()).prop_map(|(link, offering)| Key::Link { link, offering }),
        (links(), entities()).prop_map(|(link, entity)| Key::Claim { link, entity }),
        (entities(), entities()).prop_map(|(offering, demanding)| Key::Unlinked {
            offering,
            demanding
        }),
    ]
}

/// Texts that a frame takes. The machines decide whether they are schemas.
fn texts() -> impl Strategy<Value = String> {
    prop_oneof![
        "[ -~]{0,40}",
        Just("plain:u8".to_owned()),
        Just("\u{e4}".repeat(16_384)),
    ]
}

fn codes() -> impl Strategy<Value = Code> + Clone {
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
    let periods = || prop_oneof![Just(0), 1..=u64::MAX].prop_map(Period);
    let flags = || (any::<bool>(), any::<bool>(), periods(), periods());
    let publisher = (
        names(),
        types(),
        1..=1_024_u16,
        0..=1_024_u16,
        (flags(), periods()),
    );
    let subscriber = (
        names(),
        option::of(types()),
        1..=1_024_u16,
        1..=1_024_u16,
        flags(),
    );
    prop_oneof![
        publisher.prop_map(
            |(topic, data, depth, latched, ((reliable, sealed, deadline, lease), lifespan))| {
                Contract::Publisher {
                    topic,
                    data,
                    offer: OfferedQos {
                        depth,
                        reliable,
                        latched,
                        sealed,
                        deadline,
                        lifespan,
                        lease,
                    },
                }
            }
        ),
        subscriber.prop_map(
            |(topic, data, depth, max_borrowed, (reliable, sealed, deadline, lease))| {
                Contract::Subscriber {
                    topic,
                    data,
                    demand: DemandedQos {
                        depth,
                        reliable,
                        max_borrowed,
                        sealed,
                        deadline,
                        lease,
                    },
                }
            }
        ),
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
    let quota = proptest::sample::select(Quota::ALL.as_slice());
    prop_oneof![
        Just(Refusal::NameTaken),
        any::<(u16, u16)>().prop_map(|(min, max)| Refusal::Version { min, max }),
        types().prop_map(|theirs| Refusal::TopicType { theirs }),
        (types(), types()).prop_map(|(request, reply)| Refusal::ServiceType { request, reply }),
        (quota, any::<u32>()).prop_map(|(quota, limit)| Refusal::Quota { quota, limit }),
        proptest::option::of(names()).prop_map(|rule| Refusal::Denied { rule }),
        names().prop_map(|rule| Refusal::Exclusive { rule }),
    ]
}

fn limits() -> impl Strategy<Value = StatedLimits> {
    let limit = (names(), any::<u32>()).prop_map(|(name, value)| StatedLimit { name, value });
    let limits = proptest::collection::vec(limit, 0..4);
    (limits, any::<[bool; 2]>()).prop_map(|(limits, flags)| StatedLimits {
        limits,
        seal_all: flags[0],
        waive_user_boundary: flags[1],
    })
}

fn reasons() -> impl Strategy<Value = UnlinkedReason> {
    prop_oneof![
        codes().prop_map(|code| UnlinkedReason::Ended { code }),
        (nodes(), any::<u32>()).prop_map(|(node, limit)| UnlinkedReason::Quota { node, limit }),
        Just(UnlinkedReason::Descriptors),
    ]
}

fn items() -> impl Strategy<Value = Item> {
    let process = any::<(u32, i32, bool, Option<u32>)>();
    let terms = any::<(u16, bool, bool)>();
    prop_oneof![
        limits().prop_map(|limits| Item::Domain { limits }),
        (nodes(), names(), process).prop_map(|(node, name, (uid, pid, resuming, max_links))| {
            Item::Node {
                node,
                name,
                uid,
                pid,
                resuming,
                max_links,
            }
        }),
        (entities(), contracts())
            .prop_map(|(entity, contract)| Item::Interface { entity, contract }),
        (entities(), contracts(), refusals()).prop_map(|(entity, contract, reason)| {
            Item::Refusal {
                entity,
                contract,
                reason,
            }
        }),
        (links(), entities(), entities(), terms).prop_map(
            |(link, offering, demanding, (version, reliable, sealed))| Item::Link {
                link,
                offering,
                demanding,
                version,
                reliable,
                sealed,
            }
        ),
        (links(), entities()).prop_map(|(link, entity)| Item::Claim { link, entity }),
        (links(), entities(), entities()).prop_map(|(link, offering, demanding)| Item::Waiting {
            link,
            offering,
            demanding,
        }),
        (entities(), entities(), reasons()).prop_map(|(offering, demanding, reason)| {
            Item::Unlinked {
                offering,
                demanding,
                reason,
            }
        }),
    ]
}

fn changes() -> impl Strategy<Value = Change> {
    prop_oneof![
        items().prop_map(|item| Change::Set { item }),
        keys().prop_map(|key| Change::Removed { key }),
    ]
}

pub(crate) fn to_manager() -> Union<BoxedStrategy<ToManager>> {
    let unlinked = (interfaces(), links(), codes());
    let terms = any::<(u16, bool, bool)>();
    let claim = (interfaces(), links(), number(), terms);
    Union::new([
        (any::<(u16, u16, bool)>(), names())
            .prop_map(
                |((min_version, max_version, resuming), name)| ToManager::Hello {
                    min_version,
                    max_version,
                    name,
                    resuming,
                },
            )
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
        option::of(keys())
            .prop_map(|after| ToManager::Query { after })
            .boxed(),
        codes().prop_map(|code| ToManager::Goodbye { code }).boxed(),
        claim
            .prop_map(
                |(interface, link, key, (version, reliable, sealed))| ToManager::Claim {
                    interface,
                    link,
                    key: LinkKey(key),
                    version,
                    reliable,
                    sealed,
                },
            )
            .boxed(),
        Just(ToManager::Claimed).boxed(),
        number()
            .prop_map(|after| ToManager::Watch { after })
            .boxed(),
        Just(ToManager::Counters).boxed(),
        nodes().prop_map(|node| ToManager::Inspect { node }).boxed(),
        (types(), texts())
            .prop_map(|(data, text)| ToManager::Schema(SchemaText { data, text }))
            .boxed(),
        types()
            .prop_map(|data| ToManager::Describe { data })
            .boxed(),
        any::<u32>()
            .prop_map(|max_links| ToManager::MaxLinks { max_links })
            .boxed(),
        Just(ToManager::Reload).boxed(),
        number()
            .prop_map(|it| ToManager::Suspended {
                interface: InterfaceId(it),
            })
            .boxed(),
    ])
}

pub(crate) fn to_node() -> Union<BoxedStrategy<ToNode>> {
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
        link_frame().boxed(),
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
        (number(), vec(items(), 0..6), option::of(keys()))
            .prop_map(|(revision, items, next)| {
                ToNode::Page(Page {
                    revision,
                    items,
                    next,
                })
            })
            .boxed(),
        codes().prop_map(|code| ToNode::Goodbye { code }).boxed(),
        (number(), option::of(vec(changes(), 0..6)), any::<bool>())
            .prop_map(|(revision, changes, more)| {
                ToNode::Changes(Changes {
                    revision,
                    changes,
                    more,
                })
            })
            .boxed(),
        nodes().prop_map(|node| ToNode::Inspected { node }).boxed(),
        nodes()
            .prop_map(|node| ToNode::NotInspected { node })
            .boxed(),
        (types(), option::of(texts()))
            .prop_map(|(data, text)| ToNode::Described { data, text })
            .boxed(),
        Just(ToNode::CountersLost).boxed(),
        reload_outcomes()
            .prop_map(|outcome| ToNode::Reloaded { outcome })
            .boxed(),
    ])
}

fn reload_outcomes() -> impl Strategy<Value = ReloadOutcome> {
    let problems = select(vec![
        PolicyProblem::Unreadable,
        PolicyProblem::NotTrusted,
        PolicyProblem::Invalid,
    ]);
    prop_oneof![
        Just(ReloadOutcome::Applied),
        Just(ReloadOutcome::NoPolicy),
        Just(ReloadOutcome::NotPermitted),
        (problems, texts()).prop_map(|(problem, text)| ReloadOutcome::Unusable { problem, text }),
    ]
}

fn link_frame() -> impl Strategy<Value = ToNode> {
    let peer = (nodes(), names(), interfaces(), contracts()).prop_map(
        |(node, name, interface, contract)| LinkPeer {
            node,
            name,
            interface,
            contract,
        },
    );
    let terms = any::<(u16, bool, bool)>();
    (interfaces(), links(), number(), terms, peer).prop_map(
        |(interface, link, key, (version, reliable, sealed), peer)| ToNode::Link {
            interface,
            link,
            key: LinkKey(key),
            version,
            reliable,
            sealed,
            peer,
        },
    )
}
