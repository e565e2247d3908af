//! The bounds of a search: the nodes, and the events that may happen.

use sm2_proto::control::{Limit, Limits};
use sm2_proto::{Contract, DemandedQos, Name, OfferedQos, Period, ServiceQos, TypeId};

use super::Restriction;

/// How often each event may happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Budget {
    /// A program withdraws an interface, and declares it again.
    pub withdrawals: u8,
    /// A program ends a link.
    pub closes: u8,
    /// A process dies, and another one with the same name starts.
    pub node_crashes: u8,
    /// The Manager dies, and another one starts.
    pub manager_crashes: u8,
    /// The Manager gives up a node that does not read.
    pub stalls: u8,
    /// The Manager shuts down in order, and another one starts.
    pub shutdowns: u8,
    /// The domain gets the other access policy: the restriction, or none.
    pub reloads: u8,
}

/// A fault of the harness. A property finds each fault: `tests/model.rs` states which one, and in
/// which scope.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// UNLINKED never reaches the Manager.
    UnlinkedLost,
    /// WITHDRAWN overtakes earlier frames, as if there were no *dropping* state.
    WithdrawnOvertakes,
    /// CLAIM carries another key than LINK did.
    OtherKey,
    /// The next Manager starts with the same numbers as the previous one.
    EpochAgain,
    /// The Manager never sees the end of a connection.
    EndUnseen,
    /// LINK states a QoS that does not follow from the contracts.
    OtherTerms,
    /// DECLARED is sent twice.
    DeclaredTwice,
    /// CLAIMED never reaches the Manager.
    ClaimedLost,
    /// DECLARE never reaches the Manager.
    DeclareLost,
    /// The Manager's driver makes each link twice.
    LinkTwice,
    /// The last item of each page is lost.
    ItemLost,
    /// A connection gets the number of the previous one.
    SessionAgain,
    /// The Manager's driver does not poll its outputs.
    Unpolled,
    /// A node's driver closes a link that ended at the other side, without telling its machine.
    HangUpUnsaid,
    /// The Manager's driver drops the new access policy.
    PolicyLost,
    /// A node states more room for links than it has.
    RoomOverstated,
}

/// The bounds of one search.
#[derive(Clone, Debug)]
pub struct Scope {
    /// The name.
    pub name: &'static str,
    /// The contracts that the program of each node declares.
    pub programs: Vec<Vec<Contract>>,
    /// The limits of the numbers of events.
    pub budget: Budget,
    /// True if programs declare as soon as they can, in one step. Otherwise each DECLARE is a
    /// separate step, possible at any time.
    pub eager: bool,
    /// True if the search starts with all nodes connected, linked and quiet.
    pub starts_linked: bool,
    /// True if moments that differ only in names count as one, and actions whose time makes no
    /// difference go first.
    pub reduced: bool,
    /// The work that the Manager does before it serves others. One unit cuts it after each link.
    pub work_per_turn: u32,
    /// The access policy of the domain from the first reload to the second, and so on. Otherwise
    /// everything is allowed.
    pub restriction: Restriction,
    /// The number of ends of links that the first node has room for, if it states one.
    pub max_links: Option<u8>,
    /// The fault, if any.
    pub fault: Option<Fault>,
}

/// Topics of the scopes.
const LIDAR: &str = "lidar";
const CAMERA: &str = "camera";

/// Scopes that take longer than a few seconds in an optimised build.
const SLOW: [&str; 3] = ["parts-3x1", "crash-3x2", "crash-4x1"];

impl Scope {
    /// All scopes, quick ones first.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all = Self::with_withdrawals();
        all.extend(Self::with_crashes());
        all.extend(Self::with_stalls());
        all.extend(Self::with_slow_searches());
        all.extend(Self::with_reloads());
        all
    }

    /// A scope of the reduced search that begins with all nodes connected and linked.
    fn new(name: &'static str, programs: Vec<Vec<Contract>>, budget: Budget) -> Self {
        Self {
            name,
            programs,
            budget,
            eager: true,
            starts_linked: true,
            reduced: true,
            work_per_turn: Limits::default().of(Limit::WorkPerTurn),
            restriction: Restriction::NoSubscriber,
            max_links: None,
            fault: None,
        }
    }

    /// Cold starts, and programs that withdraw interfaces.
    fn with_withdrawals() -> Vec<Self> {
        vec![
            // Shows domain (model), bound: two nodes, each with a publisher and a subscriber for the other's; from
            // before HELLO; each DECLARE at any time.
            Self {
                starts_linked: false,
                eager: false,
                ..Self::new("cold-2x2", crossed(), Budget::default())
            },
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model), bound: publisher and subscriber, from before HELLO; one
            // node crash, one Manager crash.
            Self {
                starts_linked: false,
                ..Self::new("cold-crash-2x1", fan(2, &[LIDAR]), crashes(1, 1))
            },
            // Shows domain, CLI-DROPPING (model), bound: 2 nodes x 2 topics, one withdrawal at any time, DECLARE at any
            // time.
            Self {
                eager: false,
                ..Self::new("churn-once-2x2", crossed(), withdrawals(1))
            },
            // Shows domain, CLI-DROPPING (model), bound: 2 nodes x 2 topics, two withdrawals at any time, DECLARE at
            // any time.
            Self {
                eager: false,
                ..Self::new("churn-2x2", crossed(), withdrawals(2))
            },
            // Shows domain, CLI-DROPPING (model), bound: a publisher with a deadline, and two subscribers; one of these
            // demands a shorter one; one withdrawal.
            Self::new("deadline-3x1", deadlines(), withdrawals(1)),
            // Shows domain, CLI-DROPPING (model), bound: a publisher with a lease, and two subscribers; one of these
            // demands a shorter one; one withdrawal.
            Self::new("liveliness-3x1", leases(), withdrawals(1)),
            // Shows domain, CLI-SURVIVE, CLI-DROPPING (model), bound: publisher and subscriber; one withdrawal, one
            // closed link, one Manager crash.
            Self::new(
                "close-churn-takeover-2x1",
                fan(2, &[LIDAR]),
                Budget {
                    withdrawals: 1,
                    closes: 1,
                    manager_crashes: 1,
                    ..Budget::default()
                },
            ),
        ]
    }

    /// Nodes and Managers that crash.
    fn with_crashes() -> Vec<Self> {
        vec![
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model), bound: publisher and subscriber; one node crash, one
            // Manager crash.
            Self::new("crash-2x1", fan(2, &[LIDAR]), crashes(1, 1)),
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model), bound: 2 nodes x 2 topics; one node crash, one Manager
            // crash.
            Self::new("crash-2x2", crossed(), crashes(1, 1)),
            // Shows domain, CLI-SURVIVE (model), bound: 2 nodes x 2 topics; two Manager crashes.
            Self::new("takeovers-2x2", crossed(), crashes(0, 2)),
            // Shows domain, CLI-SURVIVE, CLI-DROPPING, MGR-RELEASE (model), bound: one node linked with itself; one
            // withdrawal, one close, one node crash, one Manager crash.
            Self::new(
                "self-1x1",
                vec![vec![publisher(LIDAR), subscriber(LIDAR)]],
                Budget {
                    withdrawals: 1,
                    closes: 1,
                    manager_crashes: 1,
                    node_crashes: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model), bound: a server and two clients; one node crash, one
            // Manager crash.
            Self::new("service-3", service(), crashes(1, 1)),
            // Shows domain, CLI-SURVIVE, CLI-DROPPING (model, full), bound: a server and two clients; one withdrawal,
            // one Manager crash.
            Self::new(
                "service-churn-3",
                service(),
                Budget {
                    withdrawals: 1,
                    manager_crashes: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, CLI-SURVIVE (model), bound: 3 nodes x 2 topics; one Manager crash.
            Self::new("takeover-3x2", fan(3, &[LIDAR, CAMERA]), crashes(0, 1)),
        ]
    }

    /// Nodes that stall, and Managers that shut down.
    fn with_stalls() -> Vec<Self> {
        vec![
            // Shows domain (model), bound: 2 nodes x 2 topics; the Manager gives up a node twice.
            Self::new(
                "stall-2x2",
                crossed(),
                Budget {
                    stalls: 2,
                    ..Budget::default()
                },
            ),
            // Shows domain, MGR-RELEASE (model), bound: 3 nodes x 1 topic; a node is given up, a node crashes.
            Self::new(
                "stall-crash-3x1",
                fan(3, &[LIDAR]),
                Budget {
                    stalls: 1,
                    node_crashes: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model), bound: 2 nodes x 2 topics; one shutdown, one node crash.
            Self::new(
                "shutdown-2x2",
                crossed(),
                Budget {
                    shutdowns: 1,
                    node_crashes: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, CLI-SURVIVE (model), bound: publisher and subscriber; one shutdown, one node given up, one
            // Manager crash.
            Self::new(
                "shutdown-stall-2x1",
                fan(2, &[LIDAR]),
                Budget {
                    shutdowns: 1,
                    stalls: 1,
                    manager_crashes: 1,
                    ..Budget::default()
                },
            ),
        ]
    }

    /// A Manager that works in parts, and the two largest searches.
    fn with_slow_searches() -> Vec<Self> {
        vec![
            // The order of parts is not among the orders that the reductions consider.
            // Shows domain, MGR-PACE, MGR-RELEASE (model, full), bound: one publisher, two subscribers, and a Manager
            // that cuts its work after each link; one withdrawal, one node crash; not reduced.
            Self {
                reduced: false,
                work_per_turn: 1,
                ..Self::new(
                    "parts-3x1",
                    fan(3, &[LIDAR]),
                    Budget {
                        withdrawals: 1,
                        node_crashes: 1,
                        ..Budget::default()
                    },
                )
            },
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model, full), bound: 3 nodes x 2 topics; one node crash, one
            // Manager crash.
            Self::new("crash-3x2", fan(3, &[LIDAR, CAMERA]), crashes(1, 1)),
            // Shows domain, CLI-SURVIVE, MGR-RELEASE (model, full), bound: 4 nodes x 1 topic; one node crash, one
            // Manager crash.
            Self::new("crash-4x1", fan(4, &[LIDAR]), crashes(1, 1)),
        ]
    }

    /// Access policies that change, also while the Manager does, and a node with room for one link.
    fn with_reloads() -> Vec<Self> {
        // The reductions do not consider reloads and links that wait.
        let whole = |name, programs, budget| Self {
            reduced: false,
            work_per_turn: 1,
            ..Self::new(name, programs, budget)
        };
        vec![
            // Shows domain, ACC-RELOAD, CLI-SURVIVE (model), bound: publisher and subscriber, and a Manager that cuts
            // its work after each link; the access policy denies the subscriber, and allows it again; one Manager
            // crash, at any time; not reduced.
            whole(
                "reload-takeover-2x1",
                fan(2, &[LIDAR]),
                Budget {
                    reloads: 2,
                    manager_crashes: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, ACC-RELOAD (model), bound: the same with one withdrawal and no crash.
            whole(
                "reload-churn-2x1",
                fan(2, &[LIDAR]),
                Budget {
                    reloads: 2,
                    withdrawals: 1,
                    ..Budget::default()
                },
            ),
            // Shows domain, ACC-RELOAD (model), bound: two publishers and a subscriber; the access policy makes the
            // topic exclusive, and open again; not reduced.
            Self {
                restriction: Restriction::OnePublisher,
                ..whole(
                    "reload-exclusive-3x1",
                    vec![
                        vec![publisher(LIDAR)],
                        vec![publisher(LIDAR)],
                        vec![subscriber(LIDAR)],
                    ],
                    Budget {
                        reloads: 2,
                        ..Budget::default()
                    },
                )
            },
            // Shows domain, MGR-PACE, CLI-SURVIVE (model), bound: a publisher with room for one link, and two
            // subscribers; one node crash; not reduced.
            Self {
                max_links: Some(1),
                ..whole("room-3x1", fan(3, &[LIDAR]), crashes(1, 0))
            },
        ]
    }

    /// The scopes that take at most a few seconds in an optimised build.
    #[must_use]
    pub fn quick() -> Vec<Self> {
        let mut all = Self::all();
        all.retain(|it| !SLOW.contains(&it.name));
        all
    }

    /// The scope with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|it| it.name == name)
    }
}

fn crashes(node_crashes: u8, manager_crashes: u8) -> Budget {
    Budget {
        node_crashes,
        manager_crashes,
        ..Budget::default()
    }
}

fn withdrawals(withdrawals: u8) -> Budget {
    Budget {
        withdrawals,
        ..Budget::default()
    }
}

/// Two nodes. Each publishes the topic that the other one subscribes to.
fn crossed() -> Vec<Vec<Contract>> {
    vec![
        vec![publisher(LIDAR), subscriber(CAMERA)],
        vec![subscriber(LIDAR), publisher(CAMERA)],
    ]
}

/// One node that publishes all topics, and `nodes - 1` that subscribe to all of them.
fn fan(nodes: usize, topics: &[&str]) -> Vec<Vec<Contract>> {
    let mut all = vec![topics.iter().map(|it| publisher(it)).collect::<Vec<_>>()];
    let sink: Vec<_> = topics.iter().map(|it| subscriber(it)).collect();
    all.resize(nodes, sink);
    all
}

/// A publisher that offers a deadline, and two subscribers: only the second demands one that the offer fulfils.
fn deadlines() -> Vec<Vec<Contract>> {
    with_periods(|offer| &mut offer.deadline, |demand| &mut demand.deadline)
}

/// The same for leases.
fn leases() -> Vec<Vec<Contract>> {
    with_periods(|offer| &mut offer.lease, |demand| &mut demand.lease)
}

fn with_periods(
    of_offer: fn(&mut OfferedQos) -> &mut Period,
    of_demand: fn(&mut DemandedQos) -> &mut Period,
) -> Vec<Vec<Contract>> {
    let mut all = fan(3, &[LIDAR]);
    for (contract, period) in all.iter_mut().flatten().zip([10, 9, 10]) {
        match contract {
            Contract::Publisher { offer, .. } => *of_offer(offer) = Period(period),
            Contract::Subscriber { demand, .. } => *of_demand(demand) = Period(period),
            Contract::Server { .. } | Contract::Client { .. } => {}
        }
    }
    all
}

/// One server and two clients.
fn service() -> Vec<Vec<Contract>> {
    vec![
        vec![server("plan")],
        vec![client("plan")],
        vec![client("plan")],
    ]
}

fn name(text: &str) -> Name {
    Name::new(text).expect("scopes are written with legal names")
}

fn data(text: &str) -> TypeId {
    TypeId {
        name: name(text),
        hash: 7,
    }
}

fn publisher(topic: &str) -> Contract {
    Contract::Publisher {
        topic: name(topic),
        data: data("T"),
        offer: OfferedQos {
            reliable: true,
            ..OfferedQos::new(1)
        },
    }
}

fn subscriber(topic: &str) -> Contract {
    Contract::Subscriber {
        topic: name(topic),
        data: None,
        demand: DemandedQos::new(1, 1),
    }
}

const QOS: ServiceQos = ServiceQos {
    depth: 1,
    max_borrowed: 1,
    sealed: false,
};

fn server(service: &str) -> Contract {
    Contract::Server {
        service: name(service),
        request: data("Q"),
        reply: data("A"),
        qos: QOS,
    }
}

fn client(service: &str) -> Contract {
    Contract::Client {
        service: name(service),
        types: None,
        qos: QOS,
    }
}
