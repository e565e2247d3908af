//! `sm2 why`.

use nix::{errno::Errno, sys::signal::Signal};
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::{Node, TypeId};

use crate::common::{Domain, listener, talker, until};

#[test]
fn a_link_is_explained() {
    let domain = Domain::new();
    let (_talker, one) = talker(&domain, "scan");
    let (_listener, other) = listener(&domain, "scan", 1);
    let place = format!("{one}:/scan");
    for (a, b) in [(&*one, &*other), (&*place, "scan"), ("scan", "scan")] {
        let why = domain.run(&["why", a, b]);
        assert_eq!(why.code(), 0, "{why:?}");
        assert!(why.stdout().contains("are linked"), "{why:?}");
    }
    let why = domain.json(&["why", &one, &other]);
    assert_eq!(why["linked"], true);
    assert!(why["verdict"]["finding"]["linked"].is_object(), "{why}");
    let around = domain.run(&["why", "scan"]);
    assert_eq!(around.code(), 0);
    let expected = format!("{one}'s publisher of scan is linked with {other}:scan.");
    assert!(around.stdout().contains(&expected), "{around:?}");
}

/// A name alone is that of a topic; if that makes no pair, it is that of the node with this name.
#[test]
fn a_node_may_have_the_name_of_a_topic() {
    let domain = Domain::new();
    let (detector, mapper) = (domain.node("detector"), domain.node("map"));
    let detections = detector.publisher::<[u8]>("detections").unwrap();
    let _image = detector.subscriber::<[u8]>("image").unwrap();
    let _map = mapper.publisher::<[u8]>("map").unwrap();
    let taken = mapper.subscriber::<[u8]>("detections").unwrap();
    detections.wait_for_subscribers(1).unwrap();
    let expected =
        "detector's publisher of detections and map's subscriber of detections are linked";
    for pair in [["detector", "map"], ["map", "detector"]] {
        let why = domain.run(&["why", pair[0], pair[1]]);
        assert!(why.stdout().starts_with(expected), "{why:?}");
        assert_eq!(why.code(), 0, "{why:?}");
    }
    // The topic is meant where that makes a pair.
    let viewer = domain.node("viewer");
    let _view = viewer.subscriber::<[u8]>("map").unwrap();
    let why = domain.run(&["why", "map", "viewer"]);
    let expected = "map's publisher of map and viewer's subscriber of map are linked";
    assert!(why.stdout().starts_with(expected), "{why:?}");
    drop(taken);
}

/// The link of a stopped node stays, so the verdict alone would say that all is well.
#[test]
fn a_stopped_node_is_named() {
    let domain = Domain::new();
    let (_talker, one) = talker(&domain, "scan");
    let (listener, other) = listener(&domain, "scan", 1);
    listener.signal(Signal::SIGSTOP);
    let pid = listener.pid();
    let expected = format!(
        "But node {other} (process {pid}) is stopped by a signal, so no message gets through: \
         continue it with `kill -CONT {pid}`.\n"
    );
    for arguments in [&["why", &*one, &*other][..], &["why", "scan"]] {
        until("the process is stopped", || {
            let why = domain.run(arguments).stdout();
            why.ends_with(&expected)
        });
    }
    let why = domain.json_ending_with(3, &["why", &one]);
    assert_eq!(why["stopped"][0]["node"], *other, "{why}");
    assert_eq!(
        (&why["linked"], &why["working"]),
        (&true.into(), &false.into())
    );
    listener.signal(Signal::SIGCONT);
}

#[test]
fn what_does_not_match_is_explained() {
    let domain = Domain::new();
    let (_talker, one) = talker(&domain, "scan");
    let echo = ["topic", "echo", "scan", "--reliable"];
    let _reliable = domain.start(&echo);
    domain.wait_for("scan", "subscribers", 1);
    let why = domain.run(&["why", "scan", "scan"]);
    assert_eq!(why.code(), 1, "{why:?}");
    assert!(why.stdout().contains("demands reliability"), "{why:?}");
    let why = domain.run(&["why", &one, "--json"]);
    assert_eq!(why.code(), 1, "{why:?}");
    let why: serde_json::Value = serde_json::from_str(&why.stdout()).unwrap();
    let near = &why["interfaces"][0]["near"][0]["verdict"]["finding"];
    assert_eq!(near, "reliability", "{why:#}");

    let (_other, other) = listener(&domain, "sacn", 1);
    let why = domain.run(&["why", &one, &other]);
    assert_eq!(why.code(), 1);
    assert!(
        why.stdout()
            .contains("names differ (by one character only)"),
        "{why:?}"
    );
}

#[test]
fn types_that_differ_are_compared_by_their_schemas() {
    let domain = Domain::new();
    let schema = |text: &str| sm2_proto::schema::Schema::parse(text).unwrap();
    let declare = |node: &sm2_node::Node, text: &str| {
        let data = TypeId {
            name: "nav/Point".parse().unwrap(),
            hash: schema(text).hash(),
        };
        node.register_schema(data.clone(), text).unwrap();
        data
    };
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let ours = declare(&talker, "plain:struct{x:f64,y:f64,}");
    let theirs = declare(&listener, "plain:struct{x:f64,y:f32,}");
    let _publisher = talker
        .publisher_builder::<[u8]>("point")
        .type_id(ours)
        .declare()
        .unwrap();
    // The Manager refuses it, and keeps the refusal.
    let refused = listener
        .subscriber_builder::<[u8]>("point")
        .type_id(theirs)
        .declare();
    assert!(refused.is_err());
    let why = domain.run(&["why", "talker", "listener"]);
    assert_eq!(why.code(), 1, "{why:?}");
    let text = why.stdout();
    assert!(text.contains("was refused"), "{text}");
    assert!(text.contains("y: f32 here, f64 there"), "{text}");
    let json = domain
        .run(&["why", "listener", "talker", "--json"])
        .stdout();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["linked"], false);
    assert_eq!(json["differences"].as_array().unwrap().len(), 1, "{json}");
    let info = domain.run(&["topic", "info", "point"]).stdout();
    assert!(info.contains("plain:struct{x:f64,y:f64,}"), "{info}");
    assert!(info.contains("refused: "), "{info}");
}

#[test]
fn names_that_say_too_little_or_nothing_are_told() {
    let domain = Domain::new();
    let (_one, one) = talker(&domain, "scan");
    let (_first, first) = listener(&domain, "scan", 1);
    let (_second, second) = listener(&domain, "scan", 2);
    let both = domain.run(&["why", "scan", "scan"]);
    both.failed(1, &["may be", &first, &second, "NODE:NAME"]);
    let unknown = domain.run(&["why", "sacn"]);
    unknown.failed(1, &["no topic, service or node sacn", "did you mean scan?"]);
    let unknown = domain.run(&["why", &format!("{first}:image"), "scan"]);
    let own = format!("node {first} has no interface image: {first} has the subscriber of scan");
    unknown.failed(1, &[&own]);
    // The topic is there, and the node has another one.
    let planner = domain.node("planner");
    let _path = planner.subscriber::<str>("path").unwrap();
    let other = domain.run(&["why", "planner:scan", &format!("{one}:scan")]);
    let publisher = format!("the publisher of {one}");
    let parts = [
        "no interface scan: scan is ",
        &publisher,
        "; planner has the subscriber of path",
    ];
    other.failed(1, &parts);
    domain
        .run(&["why", "nobody:scan"])
        .failed(1, &["no node nobody"]);
    let _idle = domain.node("idle");
    domain
        .run(&["why", "idle"])
        .failed(1, &["idle has declared no interface"]);
    domain
        .run(&["why", "two words"])
        .failed(2, &["a name is segments"]);
}

#[test]
fn a_denial_names_its_rule() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("policy.toml");
    let policy = "default = \"allow\"\n[[rule]]\nname = \"no-scan\"\neffect = \"deny\"\n\
                  actions = [\"subscribe\"]\nnames = [\"scan\"]\n";
    std::fs::write(&file, policy).unwrap();
    let domain = Domain::with(&["--policy", file.to_str().unwrap()]);
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let _publisher = talker.publisher::<[u8]>("scan").unwrap();
    assert!(listener.subscriber::<[u8]>("scan").is_err());
    let why = domain.run(&["why", "talker:scan", "listener:scan"]);
    assert_eq!(why.code(), 1, "{why:?}");
    assert!(
        why.stdout()
            .contains("was refused: `no-scan` of the access policy denies it"),
        "{why:?}"
    );
}

/// The publisher's node cannot send for want of memory, and says so in its counters as long as that lasts.
//= SM2-TRN-013, SM2-CNT-005 sys
#[test]
fn a_node_that_is_short_of_memory_is_named() {
    let domain = Domain::new();
    let talker = Node::builder("talker").socket(domain.path("sm2.sock"));
    // Faults are injected into the calls of this thread, which drives the whole node.
    let talker = talker.ring_lane(false).background(false).connect().unwrap();
    let publisher = talker.publisher_builder::<[u8]>("scan").reliable(true);
    let publisher = publisher.declare().unwrap();
    let listener = domain.node("listener");
    let subscriber = listener.subscriber::<[u8]>("scan").unwrap();
    until("the link is open", || {
        publisher.links().iter().any(|link| link.open)
    });
    let pair = ["why", "talker:scan", "listener:scan"];
    let around = ["why", "listener:scan"];
    let none = serde_json::json!([]);
    assert_eq!(domain.json(&pair)["short_of_memory"], none);

    let faults = Injector::counting();
    let installed = faults.install();
    faults.set([Fault {
        call: Call::SendMsg,
        nth: 1,
        times: u64::MAX,
        errno: Errno::ENOMEM as i32,
    }]);
    publisher.publish(b"held").unwrap();
    for arguments in [&pair[..], &around] {
        let why = domain.json_ending_with(3, arguments);
        // The message is still at the sender.
        assert_eq!(why["not_taking"], none);
        let [short] = &why["short_of_memory"].as_array().unwrap()[..] else {
            panic!("{why}");
        };
        assert_eq!(short["interface"], "talker:scan");
        assert_eq!(short["peer"], "listener:scan");
        assert!(short["seconds"].as_f64() >= Some(0.0), "{why}");
        let text = domain.run(arguments).stdout();
        let start = "But talker:scan has been short of memory for ";
        let line = text.lines().find(|it| it.starts_with(start));
        let line = line.unwrap_or_else(|| panic!("{text}"));
        assert!(line.contains(" s on its link with listener:scan: messages wait"));
    }
    // A call that fails again does not begin another shortage.
    let seconds = || domain.json_ending_with(3, &pair)["short_of_memory"][0]["seconds"].as_f64();
    let before = seconds();
    publisher.links();
    assert!(seconds() >= before);

    drop(installed);
    until("the message arrives", || {
        publisher.links();
        subscriber.try_recv().unwrap().is_some()
    });
    assert_eq!(domain.json(&pair)["short_of_memory"], none);
    assert!(!domain.run(&pair).stdout().contains("short of memory"));
}
