//! Messages of types that `sm2` was not built with are printed and published by their schemas.

use serde_json::json;

use crate::common::Domain;

const SCHEMA: &str = "plain:struct{x:f64,n:u32,}";

/// Publishes a value of type `nav/Point` repeatedly.
fn publish(value: &str) -> [&str; 12] {
    [
        "topic",
        "pub",
        "point",
        "--type",
        "nav/Point",
        "--schema",
        SCHEMA,
        "--value",
        value,
        "--rate",
        "200",
        "--loop",
    ]
}

#[test]
fn values_are_published_and_printed_by_their_schema() {
    let domain = Domain::new();
    let _publish = domain.start(&publish("{\"x\": 1.5, \"n\": 7}"));
    let echo = |options: &[&str]| {
        let echo = ["topic", "echo", "point", "--count", "1"];
        domain.run(&[&echo, options].concat()).stdout()
    };
    assert_eq!(echo(&[]), "{x: 1.5, n: 7}\n");
    assert_eq!(echo(&["--hex"]), "000000000000f83f07000000\n");
    assert_eq!(
        echo(&["--raw"]),
        "12 bytes: 00 00 00 00 00 00 f8 3f 07 00 00 00\n"
    );
    let line: serde_json::Value = serde_json::from_str(&echo(&["--json"])).unwrap();
    assert_eq!(line["value"], json!({ "x": 1.5, "n": 7 }));
    let both = ["topic", "echo", "point", "--hex", "--raw"];
    domain.run(&both).failed(2, &["--hex", "--raw"]);

    // Another publisher needs neither --type nor --schema.
    let value = [
        "topic",
        "pub",
        "point",
        "--value",
        "{\"x\": 0, \"n\": 1}",
        "--wait",
        "0",
    ];
    let published = domain.run(&value);
    assert_eq!(published.code(), 0, "{published:?}");
    assert!(
        published.stderr().contains("1 without a subscriber"),
        "{published:?}"
    );
    let wrong = ["topic", "pub", "point", "--value", "{\"x\": 0, \"n\": -1}"];
    domain
        .run(&wrong)
        .failed(1, &["not a message of type nav/Point", "n: "]);
    let wrong = ["topic", "pub", "point", "--value", "{x: 0}"];
    domain.run(&wrong).failed(2, &["not JSON", "quote it"]);
}

#[test]
fn built_in_types_are_printed_too() {
    let domain = Domain::new();
    let node = domain.node("node");
    let numbers = node
        .publisher_builder::<[f64]>("numbers")
        .latched(1)
        .declare()
        .unwrap();
    numbers.publish(&[1.0, -0.5]).unwrap();
    let text = node
        .publisher_builder::<str>("text")
        .latched(1)
        .declare()
        .unwrap();
    text.publish("hello").unwrap();
    let echo = |topic: &str| {
        let echo = domain.start(&["topic", "echo", topic, "--count", "1"]);
        // Nobody else drives this node.
        crate::common::until("the message is there", || {
            node.spin_once_timeout(std::time::Duration::from_millis(5))
                .unwrap();
            !echo.stdout().is_empty()
        });
        echo.finish().stdout()
    };
    assert_eq!(echo("numbers"), "[1.0, -0.5]\n");
    assert_eq!(echo("text"), "hello\n");
}

/// `--type text` is the type of Rust's `str`, in either order of arrival.
#[test]
fn text_of_the_command_is_the_str_of_rust() {
    let domain = Domain::new();
    let node = domain.node("node");
    let publish = |topic: &'static str| {
        let publish = ["topic", "pub", topic, "--type", "text", "--value"];
        let rest = ["\"hello\"", "--rate", "200", "--loop"];
        domain.start(&[&publish[..], &rest].concat())
    };
    let receive = |subscriber: sm2_node::Subscriber<str>| {
        let sample = subscriber.recv_timeout(std::time::Duration::from_secs(60));
        assert_eq!(&*sample.unwrap().unwrap(), "hello");
    };
    let _first = publish("early");
    domain.wait_for("early", "publishers", 1);
    receive(node.subscriber::<str>("early").unwrap());
    let subscriber = node.subscriber::<str>("late").unwrap();
    let _second = publish("late");
    receive(subscriber);
}

#[test]
fn a_value_of_a_built_in_type_needs_no_schema() {
    let domain = Domain::new();
    let publish = ["topic", "pub", "range", "--type", "f64-list", "--value"];
    let _publish = domain.start(&[&publish[..], &["[1, 0.5]", "--rate", "200", "--loop"]].concat());
    let echo = domain.run(&["topic", "echo", "range", "--count", "1"]);
    assert_eq!(echo.stdout(), "[1.0, 0.5]\n", "{echo:?}");
}

#[test]
fn what_is_not_of_its_type_is_shown_as_bytes() {
    let domain = Domain::new();
    let _publish = domain.start(&publish("{\"x\": 1.5, \"n\": 7}"));
    domain.wait_for("point", "publishers", 1);
    let file = domain.path("wrong");
    std::fs::write(&file, [1, 2, 3]).unwrap();
    let echo = domain.start(&["topic", "echo", "point"]);
    domain.wait_for("point", "subscribers", 1);
    let from = file.to_str().unwrap();
    let wrong = [
        "topic",
        "pub",
        "point",
        "--type",
        "nav/Point",
        "--from",
        from,
    ];
    assert_eq!(domain.run(&wrong).code(), 0);
    echo.await_stdout("3 bytes: 01 02 03  (not a message of its type: ");
}

#[test]
fn a_value_without_a_schema_is_refused() {
    let domain = Domain::new();
    let value = |more: &[&str]| {
        let value = ["topic", "pub", "a", "--wait", "0", "--value", "{\"x\": 1}"];
        domain.run(&[&value, more].concat())
    };
    value(&[]).failed(1, &["have no fields", "--from"]);
    value(&["--type", "nav/Point:7"]).failed(1, &["no node has registered the schema", "--schema"]);
    let schema = ["--type", "nav/Point:7", "--schema", SCHEMA];
    value(&schema).failed(2, &["has the hash", "0000000000000007"]);
    value(&["--schema", SCHEMA]).failed(2, &["--type"]);
    value(&["--type", "nav/Point", "--schema", "plain:struct{"]).failed(2, &["--schema"]);
    value(&["--from", "-"]).failed(2, &["--from", "--value"]);
    domain.run(&["topic", "pub", "a"]).failed(2, &["--from"]);
}
