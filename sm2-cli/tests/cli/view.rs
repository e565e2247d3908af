//! `sm2 view`: what a browser gets from a real domain.

use std::{
    fs::{self, Permissions},
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    os::unix::fs::PermissionsExt,
    thread,
    time::Duration,
};

use nix::sys::signal::Signal;
use serde_json::Value;
use sm2_tests::{
    control::{self, Qos},
    link::role,
    raw::RawNode,
};

use crate::common::{Domain, Running, SOON, copy, files, sm2, talker, until};

/// A running `sm2 view`.
struct Viewer {
    running: Running,
    /// `127.0.0.1:PORT`.
    address: String,
    /// `/TOKEN/`.
    path: String,
}

impl Viewer {
    fn start(domain: &Domain) -> Self {
        let running = domain.start(&["view"]);
        running.await_stdout("\n");
        let stdout = running.stdout();
        let url = stdout.lines().next().unwrap().strip_prefix("http://");
        let (address, path) = url.unwrap().split_once('/').unwrap();
        Self {
            address: address.to_owned(),
            path: format!("/{path}"),
            running,
        }
    }

    fn request(&self, path: &str) -> TcpStream {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        let (address, token) = (&self.address, &self.path);
        let head = format!("GET {token}{path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        stream
    }

    fn get(&self, path: &str) -> Value {
        let mut answer = String::new();
        self.request(path).read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(head.starts_with("HTTP/1.1 200 "), "{answer}");
        serde_json::from_str(body).unwrap()
    }

    /// Reads events until one fits.
    fn await_event(&self, what: &str, mut fits: impl FnMut(&Value) -> bool) -> Value {
        let mut lines = BufReader::new(self.request("api/events")).lines();
        let mut found = Value::Null;
        until(what, || {
            let line = lines.next().expect("no end").unwrap();
            let Some(json) = line.strip_prefix("data: ") else {
                return false;
            };
            found = serde_json::from_str(json).unwrap();
            fits(&found)
        });
        found
    }
}

fn has(sample: &Value, list: &str, field: &str, value: &str) -> bool {
    let list = sample.pointer(list).unwrap().as_array().unwrap();
    list.iter().any(|it| it[field] == value)
}

fn events(sample: &Value, kind: &str, node: &str) -> usize {
    let events = sample["events"].as_array().unwrap();
    let those = events
        .iter()
        .filter(|it| it["kind"] == kind && it["node"] == node);
    those.count()
}

fn has_event(sample: &Value, kind: &str, node: &str) -> bool {
    events(sample, kind, node) > 0
}

#[test]
fn the_page_shows_the_domain_and_follows_it() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let (publisher, name) = talker(&domain, "chatter");
    let listener = domain.node("listener");
    let subscriber = listener.subscriber::<[u8]>("chatter").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    let sample = viewer.await_event("the rate is shown", |sample| {
        while subscriber.try_recv().unwrap().is_some() {}
        let figures = sample["figures"].as_array().unwrap();
        let rates = |field| figures.iter().any(|it| it[field].as_f64() > Some(0.0));
        rates("out_per_s") && rates("in_per_s") && rates("delay_ns")
    });
    assert_eq!(sample["connected"], true);
    assert!(has(&sample, "/domain/nodes", "name", &name), "{sample}");
    assert!(
        has(&sample, "/domain/nodes", "name", "listener"),
        "{sample}"
    );
    assert!(has(&sample, "/domain/interfaces", "name", "chatter"));
    let offering = format!("{name}:chatter");
    assert!(
        has(&sample, "/domain/links", "offering", &offering),
        "{sample}"
    );
    let itself = format!("sm2-view-{}", viewer.running.pid());
    assert!(!has(&sample, "/domain/nodes", "name", &itself), "{sample}");
    assert!(has(&sample, "/checks", "check", "standby"), "{sample}");
    assert!(has_event(&sample, "joined", &name), "{sample}");
    // It reads counters, and never subscribes.
    let interfaces = domain.json(&["snapshot"]);
    let interfaces = interfaces["interfaces"].as_array().unwrap();
    assert!(interfaces.iter().all(|it| it["node"] != itself.as_str()));
    publisher.signal(Signal::SIGKILL);
    let sample = viewer.await_event("the kill is shown", |it| has_event(it, "left", &name));
    assert!(!has(&sample, "/domain/nodes", "name", &name), "{sample}");
    // Each node has joined once, and one of them has left.
    for (kind, node, number) in [
        ("joined", name.as_str(), 1),
        ("left", &name, 1),
        ("joined", "listener", 1),
        ("left", "listener", 0),
    ] {
        assert_eq!(
            events(&sample, kind, node),
            number,
            "{kind} {node}: {sample}"
        );
    }
}

#[test]
fn the_page_tells_why_interfaces_are_not_linked() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let node = domain.node("robot");
    let _publisher = node.publisher::<u64>("scan").unwrap();
    let _subscriber = node.subscriber::<u64>("scans").unwrap();
    let expected = domain.run(&["why", "robot:scan", "robot:scans"]);
    let lines = viewer.get("api/why?one=robot:scan&other=robot:scans");
    let lines: Vec<_> = lines
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it.as_str().unwrap())
        .collect();
    assert_eq!(lines, expected.stdout().lines().collect::<Vec<_>>());
    let mut answer = String::new();
    let mut stream = viewer.request("api/why?one=nobody");
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 404 "), "{answer}");
    assert!(answer.contains("nobody"), "{answer}");
}

#[test]
fn the_page_shows_schemas() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let node = domain.node("robot");
    let _publisher = node.publisher::<[u32]>("scan").unwrap();
    let _server = node.server::<str, u64>("count").unwrap();
    // The node registers a schema in the background.
    until("the schema is known", || {
        let lines = viewer.get("api/schema?name=scan");
        lines == serde_json::json!(["type u32-list", "plain:list[u32]"])
    });
    until("both schemas are known", || {
        let lines = viewer.get("api/schema?name=count");
        lines == serde_json::json!(["request text", "plain:string", "reply u64", "plain:u64"])
    });
    let gone = viewer.get("api/schema?name=nothing");
    assert_eq!(
        gone,
        serde_json::json!(["nothing has the name nothing any more"])
    );
    let mut answer = String::new();
    let mut stream = viewer.request("api/schema?name=/scan");
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400 "), "{answer}");
}

#[test]
fn refusals_and_violations_are_events() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let honest = domain.node("honest");
    let publisher = honest.publisher::<[u8]>("t").unwrap();
    let other = domain.node("other");
    assert!(other.publisher::<u64>("t").is_err());
    viewer.await_event("the refusal is shown", |it| {
        has_event(it, "refusal", "other")
    });
    let hostile = RawNode::welcomed(&domain.path("sm2.sock"), "hostile");
    hostile.declare(1, &control::subscriber("t", Qos::PLAIN));
    let link = hostile.linked();
    link.open(role::RECEIVER, 4);
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    // No frame has this kind.
    link.end.send([255; 8]);
    viewer.await_event("the violation is shown", |it| {
        // The publisher reads the link when it publishes.
        publisher.publish(&[1]).unwrap();
        has_event(it, "violation", "honest")
    });
}

#[test]
fn without_a_manager_the_page_says_so_and_waits_for_the_next_one() {
    let mut domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let node = domain.node("robot");
    let _publisher = node.publisher::<u64>("scan").unwrap();
    viewer.await_event("the node is shown", |it| {
        has(it, "/domain/nodes", "name", "robot")
    });
    domain.kill_manager();
    let sample = viewer.await_event("the end is shown", |it| it["connected"] == false);
    assert!(has(&sample, "/domain/nodes", "name", "robot"), "{sample}");
    domain.start_manager();
    viewer.await_event("the next Manager is shown", |it| {
        let events = it["events"].as_array().unwrap();
        it["connected"] == true
            && has(it, "/domain/nodes", "name", "robot")
            && events.iter().any(|it| it["kind"] == "take_over")
    });
}

#[test]
fn without_clients_nothing_is_sampled() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let number = || viewer.get("api/domain")["sample"].as_u64().unwrap();
    let first = viewer.await_event("three samples", |it| it["sample"].as_u64() >= Some(3));
    assert!(first["sample"].as_u64() >= Some(3));
    // Each of these requests needs one sample. Those between two requests would be due to nobody.
    until("the sampling has stopped", || {
        let before = number();
        thread::sleep(Duration::from_secs(3));
        number() == before + 1
    });
}

#[test]
fn a_signal_ends_the_command_with_status_0() {
    let domain = Domain::new();
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let viewer = Viewer::start(&domain);
        // An open page does not keep it.
        let _events = viewer.request("api/events");
        viewer.running.signal(signal);
        let finished = viewer.running.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
    }
}

#[test]
fn a_start_that_cannot_succeed_names_the_remedy() {
    let domain = Domain::new();
    let viewer = Viewer::start(&domain);
    let taken = domain.run(&["view", "--listen", &viewer.address]);
    taken.failed(1, &[&viewer.address, "--listen"]);
    domain
        .run(&["view", "--listen", "localhost"])
        .failed(2, &["--listen"]);
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("none.sock");
    let lonely = Running::start(sm2(&["view", "--socket"]).arg(socket)).finish();
    lonely.failed(1, &["no Manager", "sm2 manager"]);
}

/// The browser gets a file, since every user can read the arguments of programs.
#[test]
fn the_browser_gets_a_private_file() {
    let domain = Domain::new();
    let (bin, opened) = (domain.path("bin"), domain.path("opened"));
    fs::create_dir(&bin).unwrap();
    let opener = bin.join("xdg-open");
    let script = format!(
        "#!/bin/sh\n/bin/cp -p \"$1\" {0}.new\n/bin/mv {0}.new {0}\n",
        opened.display()
    );
    fs::write(domain.path("script"), script).unwrap();
    copy(domain.path("script"), &opener);
    fs::set_permissions(&opener, Permissions::from_mode(0o700)).unwrap();
    let mut command = domain.command(&["view", "--open"]);
    let folder = domain.path("runtime");
    fs::create_dir(&folder).unwrap();
    let running = Running::start(command.env("PATH", &bin).env("XDG_RUNTIME_DIR", &folder));
    until("the browser is opened", || opened.exists());
    let url = running.stdout();
    let text = fs::read_to_string(&opened).unwrap();
    assert!(text.contains(url.trim()), "{text}");
    let mode = fs::metadata(&opened).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    running.signal(Signal::SIGINT);
    assert_eq!(running.finish().code(), 0);
    assert_eq!(files(&folder), []);
    let mut command = domain.command(&["view", "--open"]);
    let running = Running::start(command.env("PATH", "/").env("XDG_RUNTIME_DIR", &folder));
    running.await_stderr("cannot open a browser");
    running.await_stdout("http://");
}

#[test]
fn an_address_for_other_machines_is_warned_of() {
    let domain = Domain::new();
    let running = domain.start(&["view", "--listen", "0.0.0.0:0"]);
    running.await_stderr("can be reached from other machines");
    running.await_stdout("http://0.0.0.0:");
}
