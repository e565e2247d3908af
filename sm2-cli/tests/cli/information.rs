//! `sm2 topic info` and `sm2 node info`.

use std::time::Duration;

use serde_json::json;

use crate::common::{Domain, SOON, listener, talker, until};

#[test]
fn a_topic_is_shown_with_its_type_and_interfaces() {
    let domain = Domain::new();
    let node = domain.node("imu");
    let _publisher = node
        .publisher_builder::<[f64]>("acceleration")
        .depth(3)
        .latched(2)
        .lifespan(Duration::from_secs(1))
        .declare()
        .unwrap();
    let (_listener, other) = listener(&domain, "acceleration", 1);
    let info = domain.json(&["topic", "info", "/acceleration"]);
    assert_eq!(info["name"], "acceleration");
    assert_eq!(info["type"]["name"], "f64-list");
    assert_eq!(info["type"]["schema"], "plain:list[f64]");
    let listed = &domain.list("topic")["topics"][0]["type"];
    assert_eq!(info["type"]["hash"], listed["hash"]);
    let interfaces = info["interfaces"].as_array().unwrap();
    let publisher = interfaces
        .iter()
        .find(|it| it["kind"] == "publisher")
        .unwrap();
    assert_eq!(publisher["node"], "imu");
    assert_eq!(&publisher["type"], listed);
    let qos = json!({
        "depth": 3,
        "reliable": false,
        "latched": 2,
        "sealed": false,
        "lifespan_ns": 1_000_000_000,
    });
    assert_eq!(publisher["qos"], qos);
    assert_eq!(publisher["links"], 1);
    let subscriber = interfaces
        .iter()
        .find(|it| it["kind"] == "subscriber")
        .unwrap();
    assert_eq!(subscriber["node"], other);
    assert_eq!(subscriber["type"], json!(null));

    let text = domain.run(&["topic", "info", "acceleration"]).stdout();
    assert!(text.contains("schema  plain:list[f64]"), "{text}");
    assert!(text.contains("depth 3, latched 2, lifespan 1s"), "{text}");
}

/// An emergency stop that nobody hears is counted.
//= SM2-CNT-005 sys
#[test]
fn messages_that_nobody_hears_are_shown() {
    let domain = Domain::new();
    let node = domain.node("talker");
    let publisher = node.publisher::<str>("stop").unwrap();
    let text = |arguments: &[&str]| domain.run(arguments).stdout();
    let info = ["topic", "info", "stop"];
    assert_eq!(domain.json(&info)["unheard"], json!([]));
    assert!(!text(&info).contains("while no subscriber"));
    for _ in 0..2 {
        publisher.publish("stop").unwrap();
    }
    let expected = json!([{ "publisher": "talker:stop", "messages": 2 }]);
    let told = "talker:stop published 2 messages while no subscriber was linked";
    let why = ["why", "talker:stop"];
    assert_eq!(domain.json(&info)["unheard"], expected);
    for arguments in [&info[..], &why] {
        assert!(text(arguments).contains(told), "{}", text(arguments));
    }
    // A message on a link is not counted.
    let listener = domain.node("listener");
    let subscriber = listener.subscriber::<str>("stop").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.publish("go").unwrap();
    let received = subscriber.recv_timeout(SOON).unwrap();
    assert_eq!(&*received.expect("a message"), "go");
    let pair = ["why", "talker:stop", "listener:stop"];
    for arguments in [&info[..], &pair] {
        assert_eq!(domain.json(arguments)["unheard"], expected);
    }
}

/// The leases, and how often a publisher stopped being alive.
//= SM2-CNT-005, SM2-QOS-011 sys
#[test]
fn lost_liveliness_is_shown() {
    let domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let lease = Duration::from_millis(5);
    let publisher = talker.publisher_builder::<str>("scan").liveliness(lease);
    let publisher = publisher.declare().unwrap();
    let subscriber = listener.subscriber_builder::<str>("scan").liveliness(lease);
    let subscriber = subscriber.declare().unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    until("both have lost liveliness", || {
        publisher.lost_liveliness() > 0 && subscriber.lost_liveliness() > 0
    });
    let info = domain.json(&["topic", "info", "scan"]);
    assert_eq!(info["interfaces"][0]["qos"]["liveliness_ns"], 5_000_000);
    let lost = info["lost_liveliness"].as_array().unwrap();
    assert_eq!(lost.len(), 2, "{lost:?}");
    assert!(lost.iter().all(|it| it["times"].as_u64() > Some(0)));
    let text = domain.run(&["topic", "info", "scan"]).stdout();
    assert!(text.contains("liveliness 5ms"), "{text}");
    for name in ["talker", "listener"] {
        let told = format!("{name}:scan lost liveliness ");
        assert!(text.contains(&told), "{text}");
    }
}

/// The deadlines, and the periods without a message.
//= SM2-CNT-005, SM2-QOS-009 sys
#[test]
fn missed_deadlines_are_shown() {
    let domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let period = Duration::from_millis(5);
    let publisher = talker.publisher_builder::<str>("scan").deadline(period);
    let publisher = publisher.declare().unwrap();
    let subscriber = listener.subscriber_builder::<str>("scan").deadline(period);
    let subscriber = subscriber.declare().unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    until("both have missed a deadline", || {
        for node in [&talker, &listener] {
            node.spin_some().unwrap();
        }
        let info = domain.json(&["topic", "info", "scan"]);
        assert_eq!(info["interfaces"][0]["qos"]["deadline_ns"], 5_000_000);
        let missed = info["missed_deadlines"].as_array().unwrap();
        assert!(missed.iter().all(|it| it["periods"].as_u64() > Some(0)));
        missed.len() == 2
    });
    let text = domain.run(&["topic", "info", "scan"]).stdout();
    assert!(text.contains("deadline 5ms"), "{text}");
    for name in ["talker", "listener"] {
        let told = format!("{name}:scan missed its deadline in ");
        assert!(text.contains(&told), "{text}");
    }
    drop(publisher);
    let _silent = talker.publisher::<str>("scan").unwrap();
    let why = domain
        .run(&["why", "talker:scan", "listener:scan"])
        .stdout();
    let told = "listener's subscriber of scan demands a deadline of 5ms, and talker's publisher of scan \
                offers no deadline.";
    assert!(why.contains(told), "{why}");
}

#[test]
fn a_node_is_shown_with_its_process_and_peers() {
    let domain = Domain::new();
    let (talker, one) = talker(&domain, "scan");
    let (_listener, other) = listener(&domain, "scan", 1);
    let info = domain.json(&["node", "info", &one]);
    assert_eq!([&info["name"], &info["linked_with"][0]], [&*one, &*other]);
    assert_eq!(info["pid"], talker.pid());
    assert_eq!(info["resuming"], false);
    assert_eq!(info["interfaces"][0]["name"], "scan");
    let text = domain.run(&["node", "info", &other]).stdout();
    assert!(text.contains(&format!("linked with  {one}")), "{text}");
    assert!(text.contains("subscriber"), "{text}");
    let _idle = domain.node("idle");
    let text = domain.run(&["node", "info", "/idle"]).stdout();
    assert!(text.ends_with("linked with  nobody\n"), "{text}");
}
