//! `sm2 param`.

use std::fs;

use nix::sys::signal::Signal;
use serde_json::{Value as Json, json};
use sm2_node::{
    Message, Node, Parameter, Parameters,
    params::{Table, limits::TABLE_MAX},
};

use crate::common::{Domain, cells};

/// The parameters of the node `lidar`.
struct Lidar {
    node: Node,
    max_range: Parameter<f64>,
    parameters: Parameters,
}

impl Lidar {
    fn new(domain: &Domain) -> Self {
        let node = domain.node("lidar");
        let mut builder = node.parameters_builder();
        let max_range = builder
            .parameter("max_range", 30.0)
            .range_in_steps(0.5..=100.0, 0.5)
            .description("the greatest distance, in metres")
            .add();
        drop(builder.parameter("frame", "laser".to_owned()).add());
        drop(builder.parameter("filter.sizes", vec![3_i64, 5]).add());
        drop(builder.parameter("serial", 7_i64).read_only(true).add());
        let parameters = builder.declare().unwrap();
        Self {
            node,
            max_range,
            parameters,
        }
    }
}

#[test]
fn values_are_printed_and_set() {
    let domain = Domain::new();
    let lidar = Lidar::new(&domain);
    let get = |name| {
        let got = domain.run(&["param", "get", "lidar", name]);
        assert_eq!(got.code(), 0, "{got:?}");
        got.stdout()
    };
    assert_eq!(get("max_range"), "30.0\n");
    assert_eq!(get("frame"), "laser\n");
    assert_eq!(get("filter.sizes"), "[3, 5]\n");

    // An integer is a double, and a negative number is not an option.
    let set = domain.run(&[
        "param",
        "set",
        "lidar",
        "max_range",
        "12",
        "frame",
        "base",
        "filter.sizes",
        "[-1]",
    ]);
    assert_eq!((set.code(), set.stdout().as_str()), (0, ""), "{set:?}");
    assert_eq!(lidar.max_range.get(), 12.0);
    assert_eq!(
        (get("frame").as_str(), get("filter.sizes").as_str()),
        ("base\n", "[-1]\n")
    );
    let done = domain.json(&["param", "set", "lidar", "max_range", "12.5"]);
    assert_eq!(
        done,
        json!({"node": "lidar", "parameters": 1, "revision": 3})
    );

    let row = domain.json(&["param", "get", "/lidar", "max_range"]);
    let expected = json!({
        "name": "max_range", "type": "double", "value": 12.5, "origin": "set", "revision": 3, "read_only": false,
        "range": {"from": 0.5, "to": 100.0, "step": 0.5}, "description": "the greatest distance, in metres",
    });
    assert_eq!(row, expected);
}

#[test]
fn what_cannot_be_set_says_why() {
    let domain = Domain::new();
    let lidar = Lidar::new(&domain);
    let set = |values: &[&str]| domain.run(&[&["param", "set", "lidar"], values].concat());
    set(&["max_range", "far"]).failed(2, &["max_range", "double", "such as 2.5"]);
    set(&["max_range", "1", "frame"]).failed(2, &["frame", "value"]);
    set(&["frame", "a", "max_range", "1.2"]).failed(
        1,
        &[
            "max_range is 0.5 to 100.0 in steps of 0.5",
            "nothing was set",
        ],
    );
    set(&["serial", "8"]).failed(1, &["serial is read-only"]);
    set(&["max_rnge", "1"]).failed(1, &["no parameter max_rnge", "did you mean max_range?"]);
    assert_eq!(lidar.parameters.snapshot().table().revision, 1);

    domain
        .run(&["param", "get", "lidr", "x"])
        .failed(1, &["no node lidr", "did you mean lidar?"]);
    let _talker = domain.node("talker");
    domain
        .run(&["param", "list", "talker"])
        .failed(1, &["talker has no parameters"]);
}

#[test]
fn parameters_are_listed_and_described() {
    let domain = Domain::new();
    let lidar = Lidar::new(&domain);
    let arm = domain.node("arm/left");
    let mut builder = arm.parameters_builder();
    drop(builder.parameter("grip", f64::INFINITY).add());
    let _grip = builder.declare().unwrap();

    let list = domain.run(&["param", "list"]);
    let stdout = list.stdout();
    let rows: Vec<_> = stdout.lines().map(cells).collect();
    assert_eq!(
        rows[0],
        ["NODE", "NAME", "TYPE", "VALUE", "FROM"],
        "{list:?}"
    );
    assert_eq!(rows[1], ["arm/left", "grip", "double", "inf", "default"]);
    let sizes = ["lidar", "filter.sizes", "integer[]", "[3,", "5]", "default"];
    assert_eq!(rows[4], sizes);
    assert_eq!(rows.len(), 6);
    let list = domain.json(&["param", "list", "arm/left"]);
    assert_eq!(list["nodes"][0]["parameters"][0]["value"], "inf");

    let described = domain
        .run(&["param", "describe", "lidar", "max_range", "serial"])
        .stdout();
    for part in [
        "range        0.5 to 100.0 in steps of 0.5",
        "30.0 (default)",
        "metres",
        "read-only",
    ] {
        assert!(described.contains(part), "{described}");
    }
    assert!(!described.contains("frame"), "{described}");
    let described = domain.json(&["param", "describe", "lidar"]);
    assert_eq!(described["parameters"].as_array().unwrap().len(), 4);
    drop(lidar);
}

/// A file that `dump` printed is read by `load` and by programs.
#[test]
fn a_dump_is_loaded_again() {
    let domain = Domain::new();
    let lidar = Lidar::new(&domain);
    let path = domain.path("lidar.toml");
    let file = path.to_str().unwrap();
    let dump = domain.run(&["param", "dump", "lidar"]);
    assert_eq!(dump.code(), 0, "{dump:?}");
    let text = dump.stdout();
    assert!(
        text.starts_with("[lidar]\n# the greatest distance, in metres\n"),
        "{text}"
    );
    fs::write(
        &path,
        text.replace("30.0", "40")
            .replace("laser", "tower \\u001B \\\""),
    )
    .unwrap();

    let load = domain.json(&["param", "load", "lidar", file]);
    assert_eq!(
        load,
        json!({"node": "lidar", "parameters": 2, "revision": 2})
    );
    assert_eq!(lidar.max_range.get(), 40.0);
    let frame = domain.json(&["param", "get", "lidar", "frame"]);
    assert_eq!(frame["value"], "tower \u{1b} \"");
    let again = domain.json(&["param", "load", "lidar", file]);
    assert_eq!(again["parameters"], 0);

    fs::write(&path, "['*']\nmax_range = 50\nother = 1\n[arm]\nx = 1\n").unwrap();
    domain.json(&["param", "load", "lidar", file]);
    assert_eq!(lidar.max_range.get(), 50.0);
    fs::write(&path, "[lidar]\nframe = 'a'\nmax_range = 'b'\n").unwrap();
    domain
        .run(&["param", "load", "lidar", file])
        .failed(1, &[":3: parameter max_range", "double"]);
    fs::write(&path, "[arm]\nx = 1\n").unwrap();
    domain
        .run(&["param", "load", "lidar", file])
        .failed(1, &["no table for node lidar"]);
    assert_eq!(lidar.max_range.get(), 50.0);
}

#[test]
fn changes_are_watched() {
    let domain = Domain::new();
    let lidar = Lidar::new(&domain);
    let watch = domain.start(&["param", "watch", "lidar", "max_range", "--json"]);
    watch.await_stdout("\"max_range\"");
    let frame = domain.run(&["param", "set", "lidar", "frame", "base"]);
    assert_eq!(frame.code(), 0, "{frame:?}");
    lidar.parameters.set(&lidar.max_range, 1.5).unwrap();
    watch.await_stdout("1.5");
    watch.signal(Signal::SIGINT);
    let watched = watch.finish();
    assert_eq!(watched.code(), 0, "{watched:?}");
    let stdout = watched.stdout();
    let lines: Vec<Json> = stdout
        .lines()
        .map(|it| serde_json::from_str(it).unwrap())
        .collect();
    // A change of another parameter is not printed.
    let changes: Vec<_> = lines
        .iter()
        .map(|it| (&it["revision"], &it["parameters"][0]["value"]))
        .collect();
    assert_eq!(
        changes,
        [(&json!(1), &json!(30.0)), (&json!(3), &json!(1.5))]
    );

    let watch = domain.start(&["param", "watch", "lidar", "--count", "1"]);
    watch.await_stdout("3: max_range = 1.5");
    lidar.parameters.set(&lidar.max_range, 2.0).unwrap();
    let watched = watch.finish();
    assert_eq!(watched.code(), 0, "{watched:?}");
    assert!(
        watched.stdout().ends_with("4: max_range = 2.0\n"),
        "{watched:?}"
    );
    drop(lidar.node);
}

/// A program that does not look at changes: reading works, and setting ends after its time limit.
#[test]
fn a_program_that_does_not_look_changes_nothing() {
    let domain = Domain::new();
    let node = domain.node("busy");
    let mut builder = node.parameters_builder();
    let speed = builder.parameter("speed", 1.0).add();
    let (_parameters, changes) = builder.declare_with_changes().unwrap();
    assert_eq!(
        domain.run(&["param", "get", "busy", "speed"]).stdout(),
        "1.0\n"
    );
    // On a busy machine, the values that the command reads before may come too late, too.
    let mut timeouts = ["100ms", "1s", "10s", "60s"].into_iter();
    let set = loop {
        let timeout = timeouts.next().expect("the values come in time");
        let set = domain.run(&["param", "set", "busy", "speed", "2", "--timeout", timeout]);
        if !set.stderr().contains("did not come within") {
            break set;
        }
    };
    set.failed(1, &["busy has not decided within ", "nothing was set"]);
    // The request has ended, so the program does not see it any more.
    assert!(changes.try_next().unwrap().is_none());
    assert_eq!(speed.get(), 1.0);
}

//= SM2-PRM-005 test
#[test]
fn a_table_that_breaks_the_rules_is_an_error() {
    let domain = Domain::new();
    let node = domain.node("liar");
    let publisher = node
        .publisher_builder::<Table>("parameters/liar")
        .latched(1)
        .declare()
        .unwrap();
    let lidar = Lidar::new(&domain);
    let mut table = lidar.parameters.snapshot().table().clone();
    table.parameters[1].name = "a b".to_owned();
    publisher.publish(&table).unwrap();
    domain
        .run(&["param", "list", "liar"])
        .failed(1, &["liar publishes wrong parameters", "a b"]);
}

/// A table that is too long never comes.
//= SM2-PRM-005 test
#[test]
fn a_table_that_is_too_long_is_not_read() {
    let domain = Domain::new();
    let node = domain.node("liar");
    let publisher = node.publisher_builder::<[u8]>("parameters/liar").latched(1);
    let publisher = publisher.type_id(Table::type_id()).declare().unwrap();
    publisher.publish(&vec![0; TABLE_MAX + 1]).unwrap();
    let list = ["param", "get", "liar", "x", "--timeout", "300ms"];
    domain.run(&list).failed(
        1,
        &[
            "did not come within 300 ms",
            "sm2 topic info parameters/liar",
        ],
    );
    publisher.publish(&vec![0; TABLE_MAX]).unwrap();
    domain
        .run(&["param", "get", "liar", "x"])
        .failed(1, &["not of its declared type"]);
}

/// The right to subscribe is that to read, and the right to call is that to set.
#[test]
fn access_rights_apply() {
    let folder = tempfile::tempdir().unwrap();
    let policy = folder.path().join("policy.toml");
    let text = "default = \"allow\"\n[[rule]]\nname = \"hands-off\"\neffect = \"deny\"\nactions = [\"call\"]\n\
                names = [\"parameters/**\"]\nnodes = [\"*\"]\n";
    fs::write(&policy, text).unwrap();
    let domain = Domain::with(&["--policy", policy.to_str().unwrap()]);
    let lidar = Lidar::new(&domain);
    let get = domain.run(&["param", "get", "lidar", "frame"]);
    assert_eq!(get.stdout(), "laser\n", "{get:?}");
    domain
        .run(&["param", "set", "lidar", "frame", "base"])
        .failed(1, &["parameters/lidar", "hands-off"]);
    assert_eq!(lidar.parameters.snapshot().table().revision, 1);
}
