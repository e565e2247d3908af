//! `sm2 topic list` and `sm2 node list`.

use crate::common::{Domain, Running, until};
use serde_json::{Value, json};

/// A publisher of a type, and two subscribers of another topic.
fn populate(domain: &Domain) -> Vec<Running> {
    let publisher = domain.start(&[
        "topic",
        "pub",
        "imu",
        "--from",
        "/dev/null",
        "--type",
        "sensor/Imu:ab",
        "--wait",
        "9",
    ]);
    domain.wait_for("imu", "publishers", 1);
    let echo = || domain.start(&["topic", "echo", "imu"]);
    let running = vec![
        publisher,
        echo(),
        echo(),
        domain.start(&["topic", "echo", "map"]),
    ];
    domain.wait_for("imu", "subscribers", 2);
    domain.wait_for("map", "subscribers", 1);
    running
}

fn columns(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

#[test]
fn topics_are_listed_with_their_counts() {
    let domain = Domain::new();
    let _running = populate(&domain);
    let list = domain.list("topic");
    assert!(list["revision"].as_u64().unwrap() > 0);
    let expected = json!([
        {
            "name": "imu",
            "type": { "name": "sensor/Imu", "hash": "00000000000000ab" },
            "publishers": 1, "subscribers": 2, "links": 2,
        },
        { "name": "map", "type": null, "publishers": 0, "subscribers": 1, "links": 0 },
    ]);
    assert_eq!(list["topics"], expected);

    let text = domain.run(&["topic", "list"]);
    let text = text.stdout();
    let lines: Vec<_> = text.lines().map(columns).collect();
    let expected = [
        ["TOPIC", "TYPE", "PUBLISHERS", "SUBSCRIBERS", "LINKS"],
        ["imu", "sensor/Imu", "1", "2", "2"],
        ["map", "-", "0", "1", "0"],
    ];
    assert_eq!(lines, expected);
}

#[test]
fn nodes_are_listed_with_their_counts() {
    let domain = Domain::new();
    let running = populate(&domain);
    let list = domain.list("node");
    let nodes = list["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), 4, "{list:#}");
    let publisher = nodes.iter().find(|node| node["publishers"] == 1).unwrap();
    let expected = json!({
        "id": publisher["id"],
        "name": format!("sm2-pub-{}", running[0].pid()),
        "uid": nix::unistd::geteuid().as_raw(),
        "pid": running[0].pid(),
        "publishers": 1, "subscribers": 0, "servers": 0, "clients": 0, "links": 2,
    });
    assert_eq!(*publisher, expected);
    let subscribers = nodes.iter().filter(|node| node["subscribers"] == 1);
    assert_eq!(subscribers.count(), 3);

    let text = domain.run(&["node", "list"]).stdout();
    let heading = text.lines().next().map(columns);
    let expected = [
        "NODE",
        "ID",
        "UID",
        "PID",
        "PUBLISHERS",
        "SUBSCRIBERS",
        "SERVERS",
        "CLIENTS",
        "LINKS",
    ];
    assert_eq!(heading.as_deref(), Some(&expected[..]));
    assert_eq!(text.lines().count(), 5, "{text}");
}

#[test]
fn an_empty_domain_has_nothing_to_list() {
    let domain = Domain::new();
    assert_eq!(domain.list("topic")["topics"], Value::Array(vec![]));
    assert_eq!(domain.list("node")["nodes"], Value::Array(vec![]));
    assert_eq!(domain.run(&["node", "list"]).stdout().lines().count(), 1);
}

#[test]
fn a_list_of_many_pages_is_complete() {
    let domain = Domain::new();
    let echoes: Vec<_> = (0..40)
        .map(|number| {
            let topic = format!("{}/{number}", "long-name".repeat(25));
            domain.start(&["topic", "echo", &topic])
        })
        .collect();
    until("all are there", || {
        domain.list("topic")["topics"].as_array().unwrap().len() == echoes.len()
    });
    assert_eq!(
        domain.list("node")["nodes"].as_array().unwrap().len(),
        echoes.len()
    );
}
