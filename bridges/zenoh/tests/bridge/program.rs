//! The program `sm2-bridge-zenoh`, and its commands.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

use crate::common::{ALL, World};
use sm2_bridge_zenoh::SpoolCounts;
use sm2_test_support::{SOON, until};
use zenoh::Wait;

fn command() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-bridge-zenoh"));
    command.env_remove("SM2_LOG");
    command
}

/// The program `sm2-bridge-zenoh`.
pub(crate) struct Program {
    child: Child,
    metrics: String,
    log: Receiver<String>,
}

impl Program {
    /// Starts it with a configuration and these options.
    pub(crate) fn start(config: &Path, options: &[&str]) -> Self {
        let mut command = command();
        let command = command.arg("run").arg(config).args(options);
        let command = command.args(["--metrics", "127.0.0.1:0"]);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let (sender, log) = channel();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                println!("bridge: {line}");
                let _ = sender.send(line);
            }
        });
        let mut program = Self {
            child,
            metrics: String::new(),
            log,
        };
        let line = program.wait_for("metrics are at http://");
        let (_, rest) = line.split_once("http://").unwrap();
        rest.trim_end_matches("/metrics")
            .clone_into(&mut program.metrics);
        program.wait_for("the bridge carries messages");
        program
    }

    /// The next line of its log with this text.
    pub(crate) fn wait_for(&self, text: &str) -> String {
        loop {
            let line = self.log.recv_timeout(SOON).unwrap();
            assert!(
                !line.contains('\u{1b}'),
                "no terminal, and a colour: {line}"
            );
            if line.contains(text) {
                return line;
            }
        }
    }

    /// Its metrics.
    fn metrics(&self) -> String {
        let mut stream = TcpStream::connect(&self.metrics).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        stream
            .write_all(b"GET /metrics HTTP/1.1\r\nHost: here\r\n\r\n")
            .unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    }

    /// A count of its metrics.
    pub(crate) fn count(&self, name: &str) -> u64 {
        value(&self.metrics(), &format!("{name}_total"))
    }

    /// The account of its durable topics at one moment.
    pub(crate) fn spool(&self) -> SpoolCounts {
        let metrics = self.metrics();
        let value = |name: &str| value(&metrics, &format!("spool_{name}"));
        SpoolCounts {
            offered: value("offered_total"),
            handed_over: value("handed_over_total"),
            expired: value("expired_total"),
            refused: value("refused_total"),
            spooled: value("spooled"),
            in_flight: value("in_flight"),
        }
    }

    /// The most memory that it has had, in KiB.
    pub(crate) fn peak_kib(&self) -> u64 {
        let text = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = text.lines().find_map(|it| it.strip_prefix("VmHWM:"));
        let kib = line.unwrap().trim().trim_end_matches(" kB");
        kib.parse().unwrap()
    }

    /// Ends it. Returns the last lines of its output.
    pub(crate) fn end(mut self) -> String {
        let id = self.child.id().to_string();
        let killed = Command::new("kill").args(["-TERM", &id]).status().unwrap();
        assert!(killed.success());
        let mut status = None;
        until("the program ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        assert!(status.unwrap().success());
        let mut text = String::new();
        let mut output = self.child.stdout.take().unwrap();
        output.read_to_string(&mut text).unwrap();
        text
    }
}

/// A value in the text of metrics.
fn value(metrics: &str, name: &str) -> u64 {
    let start = format!("sm2_bridge_{name}{{");
    let line = metrics.lines().find_map(|it| it.strip_prefix(&start));
    let (_, value) = line.expect(metrics).split_once("} ").unwrap();
    value.parse().unwrap()
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs a command of the program. Returns its output.
fn output(arguments: &[&str]) -> String {
    let output = command().args(arguments).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

const OUT: &str = "[[rule]]\naction = \"allow\"\nnames = \"camera/**\"\ndirection = \"out\"\n";

#[test]
fn metrics_count_the_messages_and_the_end_says_the_same() {
    let world = World::new();
    let rules =
        format!("{OUT}[[rule]]\naction = \"allow\"\nnames = \"command\"\ndirection = \"in\"\n");
    let file = world.write_config("name = \"seven\"", &world.endpoint, &rules);
    let bridge = Program::start(&file, &[]);
    assert_eq!(bridge.count("sent"), 0);
    let (sender, arrived) = channel();
    let subscriber = world.network.declare_subscriber("sm2/camera/*");
    let subscriber = subscriber.callback(move |_| sender.send(()).unwrap());
    subscriber.background().wait().unwrap();
    let camera = world.node("camera").publisher::<[u8]>("camera/image");
    let camera = camera.unwrap();
    camera.wait_for_subscribers_timeout(1, SOON).unwrap();
    for _ in 0..3 {
        camera.publish(b"image").unwrap();
        arrived.recv_timeout(SOON).unwrap();
    }
    until("the denied message is counted", || {
        let put = world.network.put("sm2/secret", "x").wait();
        put.unwrap();
        bridge.count("denied") > 0 || bridge.count("received") > 0
    });
    assert_eq!((bridge.count("sent"), bridge.count("received")), (3, 0));
    let summary = bridge.end();
    assert!(summary.starts_with("3 sent, 0 received, "), "{summary}");
}

#[test]
fn a_shadow_configuration_is_compared_and_has_no_effect() {
    let world = World::new();
    let shadow = world.write_config("name = \"seven\"", &world.endpoint, ALL);
    let shadow_file = world.path("shadow.toml");
    fs::rename(shadow, &shadow_file).unwrap();
    let file = world.write_config("name = \"seven\"", &world.endpoint, OUT);
    let robot = world.node("robot");
    let secret = robot.publisher::<[u8]>("secret").unwrap();
    let speed = robot.subscriber::<[u8]>("speed").unwrap();
    let camera = robot.publisher::<[u8]>("camera/image").unwrap();
    world
        .network
        .declare_subscriber("**")
        .callback(drop)
        .background()
        .wait()
        .unwrap();

    let (file_text, shadow_text) = (file.to_str().unwrap(), shadow_file.to_str().unwrap());
    let checked = output(&["check", file_text, "--shadow", shadow_text]);
    let lines: Vec<_> = checked.lines().skip(1).collect();
    assert_eq!(
        lines,
        [
            "network: topic camera/image would be offered (line 6)",
            "shadow: network: topic secret would be offered (line 6)"
        ],
        "{checked}"
    );
    let explained = output(&["explain", file_text, "camera/image"]);
    assert_eq!(
        explained,
        "out: allowed by the rule at line 6\nin: denied, no rule matches\n"
    );

    let bridge = Program::start(&file, &["--shadow", shadow_text]);
    bridge.wait_for("shadow: network: topic secret would be offered (line 6)");
    camera.wait_for_subscribers_timeout(1, SOON).unwrap();
    assert!(secret.links().is_empty());
    world.network.put("sm2/speed", "1").wait().unwrap();
    assert!(speed.try_recv().unwrap().is_none());
    bridge.end();
    // The same file lets the message in where it is in force.
    let bridge = Program::start(&shadow_file, &[]);
    until("the message comes", || {
        world.network.put("sm2/speed", "2").wait().unwrap();
        speed.try_recv().unwrap().is_some()
    });
    bridge.end();
}

#[test]
fn a_wrong_level_of_the_log_is_named() {
    let mut command = command();
    let command = command.args(["check", "/nowhere.toml"]);
    let output = command.env("SM2_LOG", "verbose").output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(
        text.starts_with("sm2-bridge-zenoh: SM2_LOG is \"verbose\": use "),
        "{text}"
    );
}
