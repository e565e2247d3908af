//! The texts of a domain's mirror about two interfaces, word for word.

use proptest::{collection::vec, prelude::*};
use sm2_node::explain::{Finding, NEAR_MAX, NearName, nearest, sessions, users, why};
use sm2_proto::{
    Code, Contract, EntityId, LinkId, NodeId, Quota, Refusal, TypeId,
    control::{Item, Limits, UnlinkedReason},
    domain::Domain,
    match_contracts,
    schema::Schema,
};

use super::{
    cases::cases,
    contracts::{
        client, data, name, publisher, publisher_with, scan, server, subscriber, subscriber_with,
        with_deadline, with_lease,
    },
    items::{
        LIDAR, LINK, PLANNER, at, domain, entities, interface, items, link, node, refusal, sub,
    },
};

/// The text about lidar's and planner's first interfaces.
fn text(one: &Contract, other: &Contract, more: &[Item]) -> String {
    let domain = domain(one, other, more);
    let verdict = why(&domain, at(LIDAR, 1), at(PLANNER, 1));
    assert_eq!(verdict, why(&domain, at(PLANNER, 1), at(LIDAR, 1)));
    serde_json::to_string(&verdict).expect("it is plain data");
    verdict.to_string()
}

fn point(text: &str) -> TypeId {
    TypeId {
        name: name("Point"),
        hash: Schema::parse(text).expect("a schema").hash(),
    }
}

//= SM2-MAT-003 test
#[test]
fn linked_pairs_state_their_qos() {
    let said = |one: &Contract, other: &Contract, more: &[Item]| {
        let text = text(one, other, more);
        let (what, qos) = text.split_once('\n').expect("two lines");
        assert!(what.ends_with(" are linked."), "{what}");
        qos.to_owned()
    };
    assert_eq!(
        text(&scan(), &sub(), &[link(false, false)]),
        "lidar's publisher of scan and planner's subscriber of scan are linked.\n\
         not reliable, since the subscriber does not demand it; not sealed: neither side \
         asks for it and no policy demands it, so the sender could still change a message after it \
         was sent."
    );
    let plain = publisher_with("scan", &data("Scan"), false, false);
    let qos = said(&plain, &sub(), &[link(false, false)]);
    assert!(qos.starts_with("not reliable, since the publisher does not offer it; "));
    let strict = subscriber_with("scan", None, true, true);
    assert_eq!(
        said(&scan(), &strict, &[link(true, true)]),
        "reliable, since the subscriber demands it; sealed, since planner's subscriber of scan \
         asks for it."
    );
    let limits = Limits {
        seal_all: true,
        ..Limits::default()
    };
    let more = [
        Item::Domain {
            limits: limits.into(),
        },
        node(PLANNER, "planner", 1_001, false),
        link(false, true),
    ];
    assert!(said(&scan(), &sub(), &more).ends_with(
        "; sealed, since the domain seals every link and they belong to different users."
    ));
    assert!(
        said(&scan(), &sub(), &[link(false, true)])
            .ends_with("; sealed, since it was when an earlier Manager made it.")
    );
    let (add, sum) = (data("Add"), data("Sum"));
    assert!(
        said(
            &server("add", &add, &sum),
            &client("add", None),
            &[link(true, false)]
        )
        .starts_with("reliable, as all links of services; ")
    );
}

#[test]
fn who_is_not_there() {
    let domain = domain(&scan(), &sub(), &[]);
    let said = |one, other| why(&domain, one, other).to_string();
    let gone = "there is no interface 4 of planner.\n\
                It is gone, or never was: see what the domain shows now.";
    assert_eq!(said(at(LIDAR, 1), at(PLANNER, 4)), gone);
    assert_eq!(said(at(PLANNER, 4), at(LIDAR, 1)), gone);
    let nobody = said(at(9, 4), at(LIDAR, 1));
    assert!(nobody.starts_with("there is no interface 4 of node 9.\n"));
    assert_eq!(
        said(at(LIDAR, 1), EntityId::node(NodeId(PLANNER))),
        "node planner itself is not an interface.\nName one of its interfaces."
    );
    assert_eq!(nearest(&domain, at(9, 4)), []);
    let party = |entity| why(&domain, at(LIDAR, 1), entity).other.to_string();
    assert_eq!(party(EntityId::node(NodeId(9))), "node 9");
    assert_eq!(party(at(9, 4)), "interface 4 of node 9");
}

//= SM2-MAT-001 test
#[test]
fn kinds_reliability_deadlines_and_leases() {
    assert_eq!(
        text(&scan(), &scan(), &[]),
        "lidar's publisher of scan and planner's publisher of scan are both publishers.\n\
         A publisher is linked with subscribers only."
    );
    assert_eq!(
        text(&scan(), &client("scan", None), &[]),
        "lidar's publisher of scan and planner's client of scan are not counterparts.\n\
         A publisher is linked with subscribers only, and a client with servers."
    );
    let domain = domain(&scan(), &sub(), &[]);
    let itself = why(&domain, at(LIDAR, 1), at(LIDAR, 1)).to_string();
    assert!(itself.starts_with("lidar's publisher of scan is one interface: a link joins two."));
    let plain = publisher_with("scan", &data("Scan"), false, false);
    assert_eq!(
        text(&plain, &subscriber_with("scan", None, true, false), &[]),
        "planner's subscriber of scan demands reliability, which lidar's publisher of scan does \
         not offer.\nMake the publisher reliable, or the subscriber best-effort."
    );
    let said = |offered, demanded| {
        let publisher = with_deadline(scan(), offered);
        text(&publisher, &with_deadline(sub(), demanded), &[])
    };
    assert_eq!(
        said(0, 10_000_000),
        "planner's subscriber of scan demands a deadline of 10ms, and lidar's publisher of scan offers no \
         deadline.\nLet the publisher offer a deadline of at most 10ms, or the subscriber demand a longer one."
    );
    assert!(
        said(10_000_001, 10_000_000).contains("lidar's publisher of scan offers 10.000001ms.\n")
    );
    assert!(said(10_000_000, 10_000_000).contains(" match, "));
    let said = |offered, demanded| {
        let publisher = with_lease(scan(), offered);
        text(&publisher, &with_lease(sub(), demanded), &[])
    };
    assert_eq!(
        said(0, 10_000_000),
        "planner's subscriber of scan demands a liveliness lease of 10ms, and lidar's publisher of scan offers no \
         liveliness lease.\nLet the publisher offer a liveliness lease of at most 10ms, or the subscriber demand a \
         longer one."
    );
    assert!(said(10_000_000, 10_000_000).contains(" match, "));
}

#[test]
fn names_that_look_alike() {
    let near = |one: &str, other: &str| {
        let (one, other) = (publisher(one, &data("Scan")), subscriber(other, None));
        let domain = domain(&one, &other, &[]);
        match why(&domain, at(LIDAR, 1), at(PLANNER, 1)).finding {
            Finding::Names { near } => near,
            other => panic!("{other:?}"),
        }
    };
    for (one, other, expected) in [
        ("scan", "Scan", Some(NearName::Case)),
        ("a/scan", "A/SCAN", Some(NearName::Case)),
        ("scan", "scans", Some(NearName::Edit)),
        ("scan", "can", Some(NearName::Edit)),
        ("scan", "scon", Some(NearName::Edit)),
        ("scan", "sacn", Some(NearName::Edit)),
        ("scan", "s-c-n", None),
        ("scan", "nacs", None),
        ("scan", "front/scan", Some(NearName::Segments)),
        ("a/b/scan", "scan", Some(NearName::Segments)),
        ("a/b/c/scan", "a/scan", Some(NearName::Segments)),
        ("a/b", "a/b/b", Some(NearName::Segments)),
        ("arm/joint", "arm/joint/arm/joint", Some(NearName::Segments)),
        ("arm/joint", "joint/arm/left", None),
        ("front/scan", "front/image", Some(NearName::Leading)),
        ("front/scan", "rear/image", None),
        ("scan", "image", None),
        ("scan", "scan/raw", None),
    ] {
        assert_eq!(near(one, other), expected, "{one} {other}");
        assert_eq!(near(other, one), expected, "{other} {one}");
    }
    let said = |other| text(&scan(), &subscriber(other, None), &[]);
    assert_eq!(
        said("Scan"),
        "lidar's publisher of scan and planner's subscriber of Scan: their names differ (in \
         upper and lower case only).\nIf they mean the same, rename one."
    );
    assert!(said("scans").contains("(by one character only)"));
    assert!(said("front/scan").contains("(one is the other without some segments)"));
    assert_eq!(
        said("image"),
        "lidar's publisher of scan and planner's subscriber of image: their names differ.\n\
         Only equal names are linked."
    );
}

//= SM2-NAM-003 test
#[test]
fn types_that_differ() {
    let of = |hash| TypeId {
        hash,
        ..data("Scan")
    };
    let said = |one: &TypeId, other: &TypeId| {
        text(
            &publisher("scan", one),
            &subscriber("scan", Some(other)),
            &[],
        )
    };
    let head = "lidar's publisher of scan and planner's subscriber of scan: their types differ.\n";
    assert_eq!(
        said(&of(1), &of(2)),
        format!(
            "{head}messages: both are named Scan, but the schemas differ (0000000000000001 of the \
             publisher, 0000000000000002 of the subscriber): build both from the same definition."
        )
    );
    assert_eq!(
        said(&data("Scan"), &data("Image")),
        format!(
            "{head}messages: Scan of the publisher, Image of the subscriber: one of them has to \
             change its name only."
        )
    );
    let services = text(
        &server("add", &data("Add"), &of(1)),
        &client("add", Some((&data("Plus"), &of(2)))),
        &[],
    );
    assert!(services.contains("\nrequests: Add of the server, Plus of the client: "));
    assert!(services.contains("\nreplies: both are named Scan, but the schemas differ ("));

    let (xy, xyz) = ("plain:struct{x:f64,y:f64,}", "plain:struct{x:f64,y:f32,}");
    let domain = domain(
        &publisher("scan", &point(xy)),
        &subscriber("scan", Some(&point(xyz))),
        &[],
    );
    let verdict = why(&domain, at(LIDAR, 1), at(PLANNER, 1));
    assert_eq!(
        verdict.types().collect::<Vec<_>>(),
        [&point(xy), &point(xyz)]
    );
    let known = |data: &TypeId| {
        let texts = [xy, xyz].into_iter();
        let text = texts.map(str::to_owned);
        text.clone().find(|text| point(text) == *data)
    };
    let told = verdict.clone().with_schemas(known).to_string();
    assert!(
        told.ends_with(
            "; first difference (here: publisher, there: subscriber): y: f64 here, f32 there."
        ),
        "{told}"
    );
    assert_eq!(verdict.clone().with_schemas(|_| None), verdict);
}

/// A link that waits for room counts for the quota.
//= SM2-LNK-007 test
#[test]
fn the_node_without_room_is_named() {
    let no_room = Item::Node {
        node: NodeId(PLANNER),
        name: name("planner"),
        uid: 1_000,
        pid: 7,
        resuming: false,
        max_links: Some(1),
    };
    let waiting = Item::Waiting {
        link: LinkId { serial: 2, ..LINK },
        offering: at(LIDAR, 2),
        demanding: at(PLANNER, 1),
    };
    let more = [
        no_room,
        link(false, false),
        interface(at(LIDAR, 2), &scan()),
        waiting,
    ];
    let domain = domain(&scan(), &sub(), &more);
    let verdict = why(&domain, at(LIDAR, 2), at(PLANNER, 1));
    let expected = Finding::NoRoom {
        node: NodeId(PLANNER),
        used: 1,
        max_links: 1,
    };
    assert_eq!(verdict.finding, expected);
    assert!(verdict.matches() && !verdict.is_linked());
    let text = verdict.to_string();
    assert!(
        text.contains("node planner has no room for more links: 1 of 1.")
            && text.contains("ulimit -n"),
        "{text}"
    );
    assert_eq!(sessions(&domain)[&NodeId(PLANNER)].links, 2);
}

//= SM2-WCH-004, SM2-IFC-005, SM2-IFC-006 test
#[test]
fn refusals_name_the_conflicting_interface() {
    let image = subscriber("scan", Some(&data("Image")));
    let stated = Refusal::TopicType {
        theirs: data("Scan"),
    };
    assert_eq!(
        text(&scan(), &image, &[refusal(at(PLANNER, 1), &image, &stated)]),
        "planner's subscriber of scan was refused: the topic carries messages of type Scan \
         (schema 0000000000000007), as lidar's publisher of scan states.\n\
         Use one type for both, or another name for one of them."
    );
    // The interface that stated the type is gone. A refused interface states no type.
    let refused = [
        refusal(at(LIDAR, 1), &scan(), &stated),
        refusal(at(PLANNER, 1), &image, &stated),
    ];
    assert!(
        text(&scan(), &image, &refused)
            .ends_with(".\nThe interface that stated that type is gone by now: declare again.")
    );
    let (add, sum) = (data("Add"), data("Sum"));
    let stated = Refusal::ServiceType {
        request: add.clone(),
        reply: sum.clone(),
    };
    let other = client("add", Some((&sum, &add)));
    let more = [refusal(at(PLANNER, 1), &other, &stated)];
    let said = text(&server("add", &add, &sum), &other, &more);
    assert!(
        said.contains(", as lidar's server of add states."),
        "{said}"
    );
    let quota = Refusal::Quota {
        quota: Quota::InterfacesPerSession,
        limit: 1_024,
    };
    assert_eq!(
        text(&scan(), &sub(), &[refusal(at(PLANNER, 1), &sub(), &quota)]),
        "planner's subscriber of scan was refused: the quota of 1024 interfaces per session is \
         used up: close some, or have the operator raise interfaces_per_session of the Manager."
    );
}

const BOTH_MATCH: &str = "lidar's publisher of scan and planner's subscriber of scan match";

/// The pair of both interfaces has no link for this reason.
fn unlinked(reason: UnlinkedReason) -> Item {
    Item::Unlinked {
        offering: at(LIDAR, 1),
        demanding: at(PLANNER, 1),
        reason,
    }
}

//= SM2-WCH-004, SM2-LNK-009, SM2-RES-007 test
#[test]
fn a_matching_pair_is_not_linked() {
    let said = |more: &[Item]| text(&scan(), &sub(), more);
    let both = BOTH_MATCH;
    assert_eq!(
        said(&[unlinked(UnlinkedReason::Ended { code: Code(2) })]),
        format!(
            "{both}, but one of them ended their link: the other one did not read what was sent \
             to it.\nThey are not linked again until one of them is declared anew."
        )
    );
    for (code, meaning) in [
        (71, "bad-sequence"),
        (40_000, "code 40000"),
        (0, "it was no longer needed"),
        (1, "it did not greet in time"),
        (3, "it was shutting down"),
        (4, "it ran out of descriptors, memory or quota"),
        (5, "the other end was gone without a farewell"),
        (6, "the new Manager could not take the link over"),
    ] {
        let said = said(&[unlinked(UnlinkedReason::Ended { code: Code(code) })]);
        assert!(
            said.contains(&format!("ended their link: {meaning}.\n")),
            "{said}"
        );
        assert_eq!(
            said.contains("The Manager links them again soon."),
            code == 4
        );
        assert_eq!(said.contains("declared anew"), code != 4);
    }
    let quota = |node| {
        unlinked(UnlinkedReason::Quota {
            node: NodeId(node),
            limit: 3,
        })
    };
    assert_eq!(
        said(&[quota(PLANNER)]),
        format!(
            "{both}, but planner may not have more than 3 links.\n\
             Close some and declare again, or have the operator raise links_per_session of the Manager."
        )
    );
    assert!(said(&[quota(9)]).contains("but node 9 may not have"));
    let none = said(&[unlinked(UnlinkedReason::Descriptors)]);
    assert!(none.starts_with(&format!("{both}, but the Manager had no descriptors")));
}

//= SM2-RES-002, SM2-RES-004 test
#[test]
fn a_matching_pair_waits_for_claims() {
    let said = |more: &[Item]| text(&scan(), &sub(), more);
    let both = BOTH_MATCH;
    let late = node(PLANNER, "planner", 1_000, true);
    assert_eq!(
        said(std::slice::from_ref(&late)),
        format!(
            "{both}, but the new Manager waits for planner to claim existing links.\n\
             That takes a moment: ask again."
        )
    );
    let both_late = [node(LIDAR, "lidar", 1_000, true), late.clone()];
    assert!(said(&both_late).contains("waits for lidar and planner to claim"));
    let claim = Item::Claim {
        link: LINK,
        entity: at(LIDAR, 1),
    };
    assert_eq!(
        said(&[late, claim.clone()]),
        "lidar's publisher of scan has claimed a link from the new Manager; planner's subscriber \
         of scan has not claimed it yet.\n\
         It has a few seconds for that. The link works meanwhile."
    );
    // A node that has sent CLAIMED without a claim of that link has no end of the link.
    let due = format!(
        "{both}, and nothing prevents a link.\n\
         If they are not linked in a moment, the Manager's log says why."
    );
    assert_eq!(said(&[claim]), due);
    assert_eq!(said(&[]), due);
}

proptest! {
    #![proptest_config(cases(1_000))]

    /// A verdict says *matches* of exactly those pairs that match, whichever interface is named
    /// first, and has a text for each finding.
    //= SM2-MAT-001 test
    #[test]
    fn why_agrees_with_the_rule(items in vec(items(), 0..40), one in entities(), other in entities()) {
        let mut domain = Domain::new();
        domain.page(items);
        let verdict = why(&domain, one, other);
        prop_assert_eq!(&verdict, &why(&domain, other, one));
        prop_assert!(!verdict.to_string().is_empty());
        let pair = (domain.interface(one), domain.interface(other));
        let matches = match pair {
            (Some(one), Some(other)) => {
                let granted = one.refused.is_none() && other.refused.is_none();
                granted && match_contracts(one.contract, other.contract).is_ok()
            }
            _ => false,
        };
        // The Manager decides alone which links exist, whatever other items it sends.
        prop_assert!(verdict.matches() == matches || verdict.is_linked());
        let pair = (verdict.one.entity, verdict.other.entity);
        let mut links = domain.links();
        let linked = links.any(|it| (it.offering, it.demanding) == pair);
        let known = [one, other].map(|it| domain.interface(it).is_some()) == [true; 2];
        prop_assert_eq!(verdict.is_linked(), linked && known);
        let near = nearest(&domain, one);
        prop_assert!(near.len() <= NEAR_MAX);
        for near in near {
            let expected = why(&domain, one, near.entity);
            prop_assert!(!near.verdict.is_linked());
            prop_assert_eq!(near.verdict, expected);
        }
        // Counting and listing must not panic on any items.
        prop_assert!(sessions(&domain).len() >= users(&domain).len());
    }
}
