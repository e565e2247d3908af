//! The environment that the examples of the help presuppose: nodes, files, and a second domain with a gateway.

use std::{
    env, fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use sm2_node::{Message, Node, Parameters, Publisher, Schema, Subscriber};
use tempfile::TempDir;

use crate::{
    common::{Running, copy, until},
    foreign::corrected_recording,
    gateway::address,
};

/// The topics of bytes that examples name.
const TOPICS: [&str; 8] = [
    "chatter",
    "camera",
    "log",
    "camera/front",
    "goal",
    "blob",
    "pose",
    "range",
];

#[derive(Message, Serialize, Deserialize)]
#[message(name = "sensor/Scan", encoding = "postcard")]
struct Scan {
    ranges: Vec<f32>,
}

#[derive(Message, Serialize, Deserialize)]
#[message(name = "nav/Plan", encoding = "postcard")]
struct Plan {
    goal: Point,
}

#[derive(Schema, Serialize, Deserialize)]
struct Point {
    x: f64,
    y: f64,
}

/// Programs in place of those that not every machine has.
pub(super) struct Shims(TempDir);

impl Shims {
    pub(super) fn new() -> Self {
        let shims = Self(tempfile::tempdir().unwrap());
        // jq prints each report at once; without jq its input is printed.
        shims.make(
            "jq",
            "jq=$(PATH=/usr/local/bin:/usr/bin:/bin command -v jq) || exec cat\n\
             exec \"$jq\" --unbuffered \"$@\"",
        );
        // Not every machine has man; a page starts with its title.
        shims.make("man", "grep '^[.]TH'");
        // It is built in a workspace of its own.
        shims.make("sm2-foxglove", "echo \"$@\"");
        shims
    }

    fn make(&self, name: &str, script: &str) {
        let (text, program) = (self.0.path().join("text"), self.0.path().join(name));
        fs::write(&text, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&text, PermissionsExt::from_mode(0o755)).unwrap();
        copy(&text, &program);
    }
}

/// A machine for one example: folders, domains and nodes of its own.
pub(super) struct World {
    nodes: Option<Nodes>,
    /// Managers and gateways.
    daemons: Vec<Running>,
    /// The domain of the example.
    domain: &'static str,
    shims: PathBuf,
    /// Removed last, when nobody uses it any more.
    folder: TempDir,
}

/// Whether a word stands in an example. Topics with `/` are one word.
pub(super) fn is_word_of(example: &str, word: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '/' | '-');
    let mut words = example.split(|c| !is_part(c));
    words.any(|it| it.trim_start_matches('/') == word)
}

impl World {
    /// The world that an example needs.
    pub(super) fn new(example: &str, shims: &Shims) -> Self {
        let needs_gateways = is_word_of(example, "ask") || is_word_of(example, "peers");
        let mut world = Self {
            nodes: None,
            daemons: Vec::new(),
            domain: match needs_gateways {
                true => "base",
                false => "default",
            },
            shims: shims.0.path().to_owned(),
            folder: tempfile::tempdir().unwrap(),
        };
        world.make_files(example);
        if is_word_of(example, "1970") {
            fs::write(world.path("work/1970.mcap"), corrected_recording()).unwrap();
        }
        let takes_over = example.contains("--standby") || example.contains("--replace");
        if is_word_of(example, "manager") && !takes_over {
            return world;
        }
        let arm = example.contains("--domain arm");
        for domain in ["default", "arm", "base"] {
            if domain == "default" || domain == world.domain || (domain == "arm" && arm) {
                world.serve(domain, is_word_of(example, "policy"));
            }
        }
        if is_word_of(example, "gateway") {
            world.make_gateways(example, needs_gateways);
        }
        let node = |name: &str| {
            let builder = Node::builder(name).socket(world.socket("default"));
            builder.connect().unwrap()
        };
        world.nodes = Some(Nodes::start(example, node));
        let is_control = is_word_of(example, "control");
        if is_word_of(example, "drive") || is_control {
            let record = [
                "record",
                "scan",
                "chatter",
                "-o",
                "drive.mcap",
                "--seconds",
                "0.5",
                // Only some examples have a publisher of chatter.
                "--allow-missing",
            ];
            let finished = Running::start(&mut world.sm2(&record)).finish();
            assert_eq!(finished.code(), 0, "{finished:?}");
        }
        if is_control {
            let play = ["play", "drive.mcap", "--paused"];
            let player = Running::start(&mut world.sm2(&play));
            world.daemons.push(player);
        }
        if is_word_of(example, "trigger") {
            let recorder = Running::start(&mut world.sm2(&["record", "--all", "--last", "60s"]));
            world.daemons.push(recorder);
        }
        world
    }

    /// A command in this world.
    pub(super) fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        for variable in ["SM2_SOCKET", "SM2_LOG"] {
            command.env_remove(variable);
        }
        let tools = Path::new(env!("CARGO_BIN_EXE_sm2")).parent().unwrap();
        let path = env::var("PATH").unwrap_or_default();
        command
            .env(
                "PATH",
                format!("{}:{}:{path}", self.shims.display(), tools.display()),
            )
            .env("HOME", self.path("home"))
            .env("XDG_RUNTIME_DIR", self.path("run"))
            .env("SM2_DOMAIN", self.domain)
            .env("TERM", "xterm")
            .current_dir(self.path("work"))
            .stdin(Stdio::null());
        command
    }

    /// Whether a node has received what the example publishes.
    pub(super) fn has_received(&self) -> bool {
        let nodes = self.nodes.as_ref();
        nodes.is_some_and(|nodes| nodes.received.load(Ordering::Relaxed))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn socket(&self, domain: &str) -> PathBuf {
        self.path(&format!("run/sm2/{domain}.sock"))
    }

    fn make_files(&self, example: &str) {
        for folder in [
            "run",
            "work/frames",
            "home/.config/fish/completions",
            "home/.local/share/bash-completion/completions",
            "home/.zfunc",
            "home/sm2/sm2-node",
        ] {
            fs::create_dir_all(self.path(folder)).unwrap();
        }
        fs::set_permissions(self.path("run"), PermissionsExt::from_mode(0o700)).unwrap();
        // A clone of the repository, as far as `sm2 new` looks.
        fs::write(self.path("home/sm2/sm2-node/Cargo.toml"), "").unwrap();
        for (file, len) in [
            ("request.bin", 100),
            ("robot.log", 100),
            ("disk.img", 3 << 20),
        ] {
            let line = b"some bytes\n".iter().copied().cycle();
            let bytes: Vec<_> = line.take(len).collect();
            fs::write(self.path("work").join(file), bytes).unwrap();
        }
        if is_word_of(example, "pub") {
            fs::write(self.path("work/frames/first.png"), "an image").unwrap();
        }
        if is_word_of(example, "up") {
            let program = "[program.lidar]\ncommand = \"echo ready\"\n";
            fs::write(self.path("work/robot.toml"), program).unwrap();
        }
        let parameters = "[lidar]\nmax_range = 12.5\n";
        fs::write(self.path("work/lidar.toml"), parameters).unwrap();
        let policy = "default = \"allow\"\n";
        fs::write(self.path("work/policy.toml"), policy).unwrap();
    }

    fn sm2(&self, arguments: &[&str]) -> Command {
        let mut command = self.command(env!("CARGO_BIN_EXE_sm2"));
        command.args(arguments);
        command
    }

    fn serve(&mut self, domain: &str, has_policy: bool) {
        let mut command = self.sm2(&["manager", "--domain", domain]);
        if has_policy {
            command.args(["--policy", "policy.toml"]);
        }
        let manager = Running::start(&mut command);
        let socket = self.socket(domain);
        until("the Manager listens", || socket.exists());
        self.daemons.push(manager);
    }

    /// Keys and configurations of the gateways `robot`, of the default domain, and `base`. Both run
    /// if the example asks one of them.
    fn make_gateways(&mut self, example: &str, run: bool) {
        let done = |command: &mut Command| {
            let finished = Running::start(command).finish();
            assert_eq!(finished.code(), 0, "{finished:?}");
            finished.stdout()
        };
        let base_id = done(&mut self.sm2(&["gateway", "keygen", "base.key"]));
        fs::write(self.path("work/base.id"), &base_id).unwrap();
        if is_word_of(example, "keygen") {
            return;
        }
        let robot_id = done(&mut self.sm2(&["gateway", "keygen", "robot.key"]));
        for (file, name, domain, names) in [
            ("robot.toml", "robot", "default", "**"),
            ("stricter.toml", "robot", "default", "camera/**"),
            ("base.toml", "base", "base", "**"),
        ] {
            let text = format!(
                "name = \"{name}\"\nlisten = \"127.0.0.1:0\"\nkey = \"{name}.key\"\ndomain = \"{domain}\"\n\
                 [[rule]]\naction = \"allow\"\nnames = \"{names}\"\n"
            );
            fs::write(self.path("work").join(file), text).unwrap();
        }
        if is_word_of(example, "trust") {
            return;
        }
        let trust = ["gateway", "trust"];
        for file in ["robot.toml", "stricter.toml"] {
            done(&mut self.sm2(&[&trust[..], &[file, "base", base_id.trim()]].concat()));
        }
        let peer = ["base.toml", "robot", robot_id.trim()];
        let trust_robot = [&trust[..], &peer].concat();
        if !run {
            done(&mut self.sm2(&trust_robot));
            return;
        }
        let robot = Running::start(&mut self.sm2(&["gateway", "run", "robot.toml"]));
        done(self.sm2(&trust_robot).arg(address(&robot)));
        self.daemons.push(robot);
        let base = Running::start(&mut self.sm2(&["gateway", "run", "base.toml"]));
        self.daemons.push(base);
        until("the gateway of the example's domain answers", || {
            let peers = Running::start(&mut self.sm2(&["gateway", "peers"])).finish();
            peers.code() == 0
        });
    }
}

/// The nodes of examples, moved on by a thread until they are dropped.
struct Nodes {
    received: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Nodes {
    /// The nodes are there when this returns.
    fn start(example: &str, node: impl Fn(&str) -> Node) -> Self {
        let received = Arc::new(AtomicBool::new(false));
        let over = Arc::new(AtomicBool::new(false));
        let moved = Moved::new(example, node, Arc::clone(&received));
        let stop = Arc::clone(&over);
        let thread = thread::spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                moved.step();
            }
        });
        Self {
            received,
            over,
            thread: Some(thread),
        }
    }
}

impl Drop for Nodes {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        // A failed thread has already printed its reason; the example fails then.
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// The nodes and what they have declared.
struct Moved {
    nodes: Vec<Node>,
    scan: Publisher<Scan>,
    scans: Vec<Subscriber<Scan>>,
    publishers: Vec<Publisher<[u8]>>,
    subscribers: Vec<Subscriber<[u8]>>,
    /// Answers a service, as long as the node lives.
    servers: Vec<Box<dyn Fn() + Send>>,
    received: Arc<AtomicBool>,
    _parameters: Option<Parameters>,
}

impl Moved {
    fn new(example: &str, node: impl Fn(&str) -> Node, received: Arc<AtomicBool>) -> Self {
        let talker = node("talker");
        let listener = node("listener");
        let logger = node("logger");
        let publisher = talker.publisher_builder::<Scan>("scan");
        let scan = publisher.declare().unwrap();
        let scans = [&listener, &logger].map(|it| it.subscriber::<Scan>("scan").unwrap());
        let named = || TOPICS.into_iter().filter(|it| is_word_of(example, it));
        // An example that publishes needs nobody else who does.
        let is_publisher = is_word_of(example, "pub");
        let publishers = named().filter(|_| !is_publisher).map(|topic| {
            let builder = talker.publisher_builder::<[u8]>(topic).reliable(true);
            let builder = builder.publish_timeout(Duration::ZERO);
            builder.declare().unwrap()
        });
        let subscribers = named().map(|topic| {
            let builder = listener.subscriber_builder::<[u8]>(topic).any_type();
            builder.declare().unwrap()
        });
        let (publishers, subscribers) = (publishers.collect(), subscribers.collect());
        let mut nodes = vec![talker, listener, logger];
        let mut servers: Vec<Box<dyn Fn() + Send>> = Vec::new();
        if !example.contains("gone") {
            let driver = node("driver");
            let sum = driver.server::<[f64], f64>("sum").unwrap();
            servers.push(Box::new(move || {
                while let Ok(Some(request)) = sum.try_recv() {
                    let total = request.iter().sum();
                    drop(request.reply(&total));
                }
            }));
            let plan = driver.server::<Plan, Plan>("plan").unwrap();
            servers.push(Box::new(move || {
                while let Ok(Some(request)) = plan.try_recv() {
                    let Plan {
                        goal: Point { x, y },
                    } = *request;
                    let goal = Point { x, y };
                    drop(request.reply(&Plan { goal }));
                }
            }));
            for name in ["blob", "map/save"] {
                let server = driver.server::<[u8], [u8]>(name).unwrap();
                servers.push(Box::new(move || {
                    while let Ok(Some(request)) = server.try_recv() {
                        drop(request.reply(b"done"));
                    }
                }));
            }
            nodes.push(driver);
        }
        let has_parameters = is_word_of(example, "param");
        let parameters = has_parameters.then(|| parameters(&node("lidar")));
        Self {
            nodes,
            scan,
            scans: scans.into(),
            publishers,
            subscribers,
            servers,
            received,
            _parameters: parameters,
        }
    }

    /// Publishes to every topic, takes what there is, and answers calls.
    fn step(&self) {
        let ranges = vec![1.5, 2.5];
        // Failures show in the example: it finds no messages.
        drop(self.scan.publish(&Scan { ranges }));
        for publisher in &self.publishers {
            drop(publisher.publish(b"hello"));
        }
        for scans in &self.scans {
            while let Ok(Some(_)) = scans.try_recv() {}
        }
        for subscriber in &self.subscribers {
            while let Ok(Some(_)) = subscriber.try_recv() {
                self.received.store(true, Ordering::Relaxed);
            }
        }
        for server in &self.servers {
            server();
        }
        for node in &self.nodes {
            drop(node.spin_once_timeout(Duration::from_millis(2)));
        }
    }
}

/// The parameters of the node `lidar`.
fn parameters(lidar: &Node) -> Parameters {
    let mut builder = lidar.parameters_builder();
    drop(builder.parameter("min_range", 0.5).add());
    drop(builder.parameter("max_range", 30.0).add());
    drop(builder.parameter("frame", "laser".to_owned()).add());
    builder.declare().unwrap()
}
