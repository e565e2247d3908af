//! `sm2 snapshot`.

use nix::sys::signal::Signal;
use serde_json::Value;
use sm2_proto::control::{Limit, Unit};

use crate::common::{Domain, listener, talker, until};

#[test]
fn it_shows_nodes_interfaces_links_counters_and_quotas() {
    let domain = Domain::with(&["--interfaces-per-session", "7"]);
    let (_talker, one) = talker(&domain, "scan");
    let (listener, other) = listener(&domain, "scan", 1);
    listener.await_stdout("hello");
    // The publisher learns of a delivery when it publishes the next message.
    let mut snapshot = Value::Null;
    until("a message was delivered", || {
        snapshot = domain.json(&["snapshot"]);
        let delivered = &snapshot["links"][0]["counters"]["delivered"];
        delivered.as_u64().is_some_and(|it| it > 0)
    });
    let names: Vec<_> = snapshot["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| &it["name"])
        .collect();
    assert_eq!(names, [&*one, &*other]);
    assert_eq!(snapshot["interfaces"].as_array().unwrap().len(), 2);
    let link = &snapshot["links"][0];
    assert_eq!(link["offering"], format!("{one}:scan"));
    assert_eq!(link["demanding"], format!("{other}:scan"));
    assert!(link["taken"]["messages"].as_u64().unwrap() > 0, "{link}");
    assert_eq!(snapshot["limits"]["interfaces_per_session"], 7);
    let mut quotas = snapshot["quotas"].as_array().unwrap().iter();
    let own = quotas.find(|it| it["of"] == format!("node {one}") && it["quota"] == "interfaces");
    let own = own.unwrap();
    assert_eq!((&own["used"], &own["limit"]), (&1.into(), &7.into()));

    let text = domain.run(&["snapshot", "--limits"]).stdout();
    for part in [
        "2 nodes, 2 interfaces, 1 link\n",
        &format!("{one}:scan"),
        "best effort",
        "QUOTA OF",
    ] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
}

//= SM2-WCH-005 sys
#[test]
fn the_limits_in_force_are_shown() {
    let set = Limit::ALL.map(|limit| match limit.unit() {
        Unit::Bytes => (limit, 300_007),
        // Parts are not more than their wholes, as each has the same limit. The Manager starts within this time.
        Unit::Count | Unit::Milliseconds => (limit, 60_007),
    });
    let option = |limit: Limit| format!("--{}", limit.name().replace('_', "-"));
    let options = set.map(|(limit, stated)| [option(limit), stated.to_string()]);
    let options: Vec<&str> = options.iter().flatten().map(String::as_str).collect();
    let domain = Domain::with(&options);
    let node = domain.node("talker");
    let _publisher = node.publisher::<str>("scan").unwrap();
    for command in ["snapshot", "doctor"] {
        let document = domain.json(&[command]);
        let text = domain.run(&[command, "--limits"]).stdout();
        for (limit, in_force) in set {
            assert_eq!(document["limits"][limit.name()], in_force, "{document}");
            let row = text
                .lines()
                .find(|it| it.starts_with(limit.name()))
                .unwrap();
            let cells: Vec<&str> = row.split_whitespace().collect();
            assert_eq!(cells[..2], [limit.name(), &in_force.to_string()]);
        }
        let mut quotas = document["quotas"].as_array().unwrap().iter();
        let own = quotas.find(|it| it["of"] == "node talker" && it["quota"] == "interfaces");
        assert_eq!(own.unwrap()["used"], 1);
        let row = text
            .lines()
            .find(|it| it.starts_with("interfaces_per_session"));
        assert!(row.unwrap().contains("1 by node talker"), "{text}");
    }
}

#[test]
fn changes_are_streamed_until_it_is_stopped() {
    let domain = Domain::new();
    let (_talker, one) = talker(&domain, "scan");
    let watch = domain.start(&["snapshot", "--watch"]);
    let json = domain.start(&["snapshot", "--watch", "--json"]);
    watch.await_stdout(&format!("+ publisher {one}:scan: bytes"));
    let (listener, other) = listener(&domain, "scan", 1);
    watch.await_stdout(&format!("+ link {one}:scan -> {other}:scan"));
    // A slow watcher sees larger steps, and no link that came and went within one of them.
    json.await_stdout("\"item\":\"link\"");
    drop(listener);
    watch.await_stdout(&format!("- node {other}"));
    json.await_stdout(&format!("\"name\":\"{other}\""));
    let removed = |line: &str| {
        let line: Value = serde_json::from_str(line).unwrap();
        line["change"] == "removed" && line["item"] == "link"
    };
    crate::common::until("the link is gone in JSON", || {
        let stdout = json.stdout();
        let (whole, _) = stdout.rsplit_once('\n').unwrap_or_default();
        whole.lines().any(removed)
    });
    for watch in [watch, json] {
        watch.signal(Signal::SIGINT);
        let itself = format!("sm2-snapshot-{}", watch.pid());
        let watch = watch.finish();
        assert_eq!((watch.code(), watch.stderr()), (0, String::new()));
        assert!(!watch.stdout().contains(&itself), "{watch:?}");
    }
}

#[test]
fn an_empty_domain_is_shown_too() {
    let domain = Domain::new();
    let snapshot = domain.json(&["snapshot"]);
    assert_eq!(snapshot["nodes"], Value::Array(vec![]));
    let text = domain.run(&["snapshot"]).stdout();
    assert!(text.contains("0 nodes, 0 interfaces, 0 links"), "{text}");
}
