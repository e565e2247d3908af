//! Runs every example as a user does.

use crate::common;
use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::{Domain, SOON};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use sm2_node::Node;
use sm2_node::params::{Assignment, SetParameters, SetParametersResult};
use sm2_test_support::wait_until_stopped;

const LOOPS: [&str; 3] = ["loop_epoll", "loop_mio", "loop_io_uring"];
/// A timer period, in milliseconds, that does not elapse during a test.
const NEVER: &str = "100000000";

/// A running example. Killed when dropped.
struct Example(Child);

impl Example {
    fn start(domain: &Domain, name: &str, arguments: &[&str]) -> Self {
        Self::start_at(&domain.socket(), name, arguments)
    }

    fn start_at(socket: &std::path::Path, name: &str, arguments: &[&str]) -> Self {
        Self::start_with(socket, name, arguments, |_| {})
    }

    /// Starts it with more variables.
    fn start_with(
        socket: &std::path::Path,
        name: &str,
        arguments: &[&str],
        set_up: impl FnOnce(&mut Command),
    ) -> Self {
        let mut command = Command::new(path(name));
        command.args(arguments).env("SM2_SOCKET", socket);
        set_up(&mut command);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Self(command.spawn().unwrap())
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.0.id().try_into().unwrap()), signal).unwrap();
        if signal == Signal::SIGSTOP {
            wait_until_stopped(self.0.id());
        }
    }

    fn take_stdout(&mut self) -> BufReader<ChildStdout> {
        BufReader::new(self.0.stdout.take().unwrap())
    }

    /// Waits for the end, and returns the output.
    fn finish(mut self) -> Output {
        let child = &mut self.0;
        // Reads while the example runs, because a full pipe would block it.
        let stdout = child.stdout.take().map(read_all);
        let stderr = child.stderr.take().map(read_all);
        let deadline = Instant::now() + SOON;
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if Instant::now() > deadline {
                child.kill().unwrap();
                let stdout = stdout.map(|it| it.join().unwrap());
                let text = String::from_utf8(stdout.unwrap_or_default()).unwrap();
                panic!("the example does not end; its output: {text}");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let text = |it: Option<std::thread::JoinHandle<_>>| it.map(|it| it.join().unwrap());
        Output {
            status,
            stdout: text(stdout).unwrap_or_default(),
            stderr: text(stderr).unwrap_or_default(),
        }
    }

    /// Waits for a successful end, and returns the output.
    fn output(self) -> String {
        let Output {
            status,
            stdout,
            stderr,
        } = self.finish();
        let stdout = String::from_utf8(stdout).unwrap();
        let stderr = String::from_utf8(stderr).unwrap();
        assert!(status.success(), "{status}: {stdout}{stderr}");
        assert_eq!(stderr, "");
        stdout
    }
}

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn read_all(mut stream: impl std::io::Read + Send + 'static) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        bytes
    })
}

pub(crate) fn path(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(
        path.exists(),
        "{path:?} is built by: cargo test -p sm2-node"
    );
    path
}

#[test]
fn talker_and_listener() {
    let domain = Domain::new();
    let talker = Example::start(&domain, "talker", &["3"]);
    let listener = Example::start(&domain, "listener", &["3"]);
    let heard = listener.output();
    assert_eq!(
        heard.lines().collect::<Vec<_>>(),
        [
            "talker said: hello 1",
            "talker said: hello 2",
            "talker said: hello 3"
        ]
    );
    talker.output();
}

#[test]
fn camera() {
    let text = Example::start(&Domain::new(), "camera", &["5"]).output();
    assert_eq!(text.lines().count(), 5);
    assert!(text.contains("1920 x 1080, brightness 4, "), "{text}");
}

/// Ctrl-C ends each program of a tutorial that does not end by itself: with success, and without a word.
#[test]
fn a_signal_ends_the_programs_of_the_tutorials() {
    let domain = Domain::new();
    let node = domain.node("operator");
    let images = node
        .subscriber_builder::<[u8]>("camera/image")
        .any_type()
        .declare()
        .unwrap();
    let mut camera = Example::start(&domain, "camera", &["1000000"]);
    assert!(!common::next(&images).is_empty());
    let mut first = String::new();
    let mut lines = camera.take_stdout();
    lines.read_line(&mut first).unwrap();
    let scans = node.subscriber::<[f64]>("scan").unwrap();
    let lidar = Example::start(&domain, "lidar_parameters", &[]);
    assert_eq!(*common::next(&scans), [2.5, 20.0]);
    let client = node.client::<[f64], f64>("add").unwrap();
    let server = Example::start(&domain, "add_server", &[]);
    client.wait_for_servers_timeout(1, SOON).unwrap();
    for example in [camera, lidar, server] {
        example.signal(Signal::SIGINT);
        let Output { status, stderr, .. } = example.finish();
        assert_eq!(String::from_utf8(stderr).unwrap(), "");
        assert!(status.success(), "{status}");
    }
}

/// As under systemd with `Type=notify` and `WatchdogSec=`: the program says that it is ready, that its control loop
/// runs, and that it stops.
#[test]
fn supervised() {
    let domain = Domain::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(SOON)).unwrap();
    let example = Example::start_with(&domain.socket(), "supervised", &[], |command| {
        command
            .env("NOTIFY_SOCKET", &path)
            .env("WATCHDOG_USEC", "20000");
    });
    let next = || {
        let mut buffer = [0; 256];
        let len = socket.recv(&mut buffer).unwrap();
        String::from_utf8(buffer[..len].to_vec()).unwrap()
    };
    assert_eq!(next().trim(), "READY=1");
    for _ in 0..3 {
        assert_eq!(next().trim(), "WATCHDOG=1");
    }
    example.signal(Signal::SIGTERM);
    let last = std::iter::repeat_with(next).find(|it| it.trim() != "WATCHDOG=1");
    assert_eq!(last.unwrap().trim(), "STOPPING=1");
    assert_eq!(example.output(), "");

    // Without systemd, there is nothing to tell.
    let text = Example::start(&Domain::new(), "supervised", &["3"]).output();
    assert_eq!(text, "");
}

#[test]
fn add_server_and_client() {
    let domain = Domain::new();
    let server = Example::start(&domain, "add_server", &["1"]);
    let client = Example::start(&domain, "add_client", &["1", "2.5", "4"]);
    assert_eq!(client.output(), "add-server says 7.5\n");
    assert!(server.output().contains("[1.0, 2.5, 4.0]"));
}

#[test]
fn map_latched() {
    let text = Example::start(&Domain::new(), "map_latched", &[]).output();
    assert!(text.contains("dock at 7.25, 0"), "{text}");
}

#[test]
fn robot() {
    let domain = Domain::new();
    let node = domain.node("operator");
    let speed = node.subscriber::<f64>("speed").unwrap();
    let set_speed = node.client::<f64, f64>("set_speed").unwrap();
    let steps = node.client::<str, u64>("steps").unwrap();
    let example = Example::start(&domain, "robot", &[]);
    set_speed.wait_for_servers_timeout(1, SOON).unwrap();
    steps.wait_for_servers_timeout(1, SOON).unwrap();
    assert_eq!(*common::next(&speed), 0.0);
    assert_eq!(*set_speed.call_timeout(&1.5, SOON).unwrap(), 0.0);
    common::until(|| *common::next(&speed) == 1.5);
    let first = *steps.call_timeout("", SOON).unwrap();
    common::until(|| *steps.call_timeout("", SOON).unwrap() > first);
    example.signal(Signal::SIGINT);
    assert_eq!(example.output(), "");

    let text = Example::start(&domain, "robot", &["0"]).output();
    assert!(text.contains("brightness"), "{text}");
}

#[test]
fn lidar_parameters() {
    let domain = Domain::new();
    let node = domain.node("operator");
    let scans = node.subscriber::<[f64]>("scan").unwrap();
    let client = node
        .client::<SetParameters, SetParametersResult>("parameters/lidar")
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.toml");
    std::fs::write(&file, "[lidar]\nmax_range = 10\n").unwrap();
    let file = file.to_str().unwrap();
    let _example = Example::start(&domain, "lidar_parameters", &[file]);
    assert_eq!(*common::next(&scans), [2.5]);

    client.wait_for_servers_timeout(1, SOON).unwrap();
    let set = |name: &str, value: f64| {
        let (name, value) = (name.to_owned(), value.into());
        let parameters = vec![Assignment { name, value }];
        let request = SetParameters { parameters };
        (*client.call_timeout(&request, SOON).unwrap()).clone()
    };
    assert!(set("max_range", 50.0).successful);
    common::until(|| *common::next(&scans) == [2.5, 20.0]);
    let refused = set("min_range", 60.0);
    assert_eq!(refused.reason, "min_range has to be less than max_range");

    std::fs::write(file, "[lidar]\n\nmin_range = 'near'\n").unwrap();
    let second = Domain::new();
    let Output { status, stderr, .. } =
        Example::start(&second, "lidar_parameters", &[file]).finish();
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(!status.success());
    let expected = format!("lidar: {file}:3: parameter min_range: double is expected");
    assert!(stderr.starts_with(&expected), "{stderr}");
}

/// The environment has precedence over the file of `SM2_PARAMS`, and that of an argument, too.
//= SM2-PRM-006 test
#[test]
fn parameters_come_from_the_environment() {
    let domain = Domain::new();
    let scans = domain.node("operator").subscriber::<[f64]>("scan").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.toml");
    std::fs::write(&file, "[lidar]\nmin_range = 3\nmax_range = 10\n").unwrap();
    let _example = Example::start_with(&domain.socket(), "lidar_parameters", &[], |command| {
        command.env("SM2_PARAMS", &file);
        command.env("SM2_PARAM_MAX_RANGE", "90");
    });
    assert_eq!(*common::next(&scans), [20.0, 80.0]);
}

/// Without a conductor, inputs are handled as they arrive.
#[test]
fn filter_lockstep() {
    let domain = Domain::new();
    let node = domain.node("sensor");
    let mean = node.subscriber::<f32>("mean").unwrap();
    let distance = node.publisher::<f32>("distance").unwrap();
    let example = Example::start(&domain, "filter_lockstep", &[]);
    distance.wait_for_subscribers_timeout(1, SOON).unwrap();
    distance.publish(&8.0).unwrap();
    common::until(|| *common::next(&mean) == 1.0);
    example.signal(Signal::SIGINT);
    assert_eq!(example.output(), "");
}

/// An error is one line on standard error that says what to do.
#[test]
fn an_error_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("nobody.sock");
    for name in [
        "talker",
        "listener",
        "camera",
        "add_server",
        "add_client",
        "map_latched",
        "robot",
        "supervised",
        "filter_lockstep",
        "loop_epoll",
        "loop_mio",
        "loop_io_uring",
    ] {
        let example = Example::start_at(&nowhere, name, &["1"]);
        let Output {
            status,
            stdout,
            stderr,
        } = example.finish();
        if is_refused(&String::from_utf8(stdout).unwrap()) {
            continue;
        }
        let text = String::from_utf8(stderr).unwrap();
        let expected = format!("{name}: no Manager at {nowhere:?} (");
        assert!(text.starts_with(&expected), "{name}: {text}");
        assert!(text.ends_with("(SM2_DOMAIN, SM2_SOCKET)\n"), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert_eq!(status.code(), Some(1), "{name}");
    }
    let example = Example::start_at(&nowhere, "talker", &["often"]);
    let text = String::from_utf8(example.finish().stderr).unwrap();
    assert_eq!(text, "talker: argument 1 is \"often\": give a u64\n");
}

/// As in `listener | head -n 1`.
#[test]
fn output_that_nobody_reads_ends_it_quietly() {
    let domain = Domain::new();
    for name in ["listener", "loop_epoll"] {
        let mut listener = Example::start(&domain, name, &[]);
        drop(listener.take_stdout());
        let talker = domain.builder(&format!("talker-to-{name}"));
        let talker = talker.background(true).connect().unwrap();
        let publisher = talker.publisher_builder::<str>("chatter").latched(1);
        let publisher = publisher.declare().unwrap();
        // The talker's thread sends the message when the listener is linked.
        publisher.publish("is anybody there?").unwrap();
        assert_eq!(listener.output(), "");
    }
}

/// Whether the kernel refuses io_uring to this process, so that there is nothing to test.
fn is_refused(output: &str) -> bool {
    let refused = output.starts_with("no io_uring here: ");
    if refused {
        sm2_test_support::skip(output.trim());
    }
    refused
}

/// Runs `test` with each loop, once the loop has subscribed, and with a node that publishes to it.
fn in_each_loop(arguments: &[&str], test: impl Fn(&mut Domain, &Node, &str, Example)) {
    for name in LOOPS {
        let mut domain = Domain::new();
        if name == "loop_io_uring" {
            let nobody = domain.socket().with_extension("nobody");
            let example = Example::start_at(&nobody, name, &[]);
            if is_refused(&String::from_utf8(example.finish().stdout).unwrap()) {
                continue;
            }
        }
        let node = domain.node("talker");
        let example = Example::start(&domain, name, arguments);
        let publisher = node.publisher::<str>("chatter").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        drop(publisher);
        test(&mut domain, &node, name, example);
    }
}

fn hello(numbers: std::ops::RangeInclusive<u64>) -> Vec<String> {
    let line = |number| format!("talker said: hello {number}");
    numbers.map(line).collect()
}

/// Messages come in bursts. In between, the loop's own timer triggers a publication, which also reads the
/// sockets. All messages arrive in order.
#[test]
fn a_loop_misses_nothing() {
    in_each_loop(&["1000", "10"], |_, node, name, example| {
        let heartbeat = node.subscriber::<u64>("heartbeat").unwrap();
        let publisher = node.publisher_builder::<str>("chatter").depth(1_024);
        let publisher = publisher.declare().unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        let mut last = *common::next(&heartbeat);
        for burst in 0..10 {
            for number in 1..=100 {
                let text = format!("hello {}", burst * 100 + number);
                assert_eq!(publisher.publish(&text).unwrap().links, 1);
            }
            if burst < 9 {
                let beat = common::next(&heartbeat);
                assert!(beat.lost() > 0 || *beat == last + 1, "{name}");
                last = *beat;
            }
        }
        assert!(publisher.flush_timeout(SOON).unwrap());
        let heard = example.output();
        assert_eq!(heard.lines().collect::<Vec<_>>(), hello(1..=1000), "{name}");
    });
}

/// One wake-up announces more messages than one iteration takes, and no other event follows.
#[test]
fn a_loop_that_was_held_up_takes_all_that_waits() {
    in_each_loop(&["150", NEVER], |_, node, name, example| {
        let publisher = node.publisher_builder::<str>("chatter").depth(1_024);
        let publisher = publisher.declare().unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        example.signal(Signal::SIGSTOP);
        for number in 1..=150 {
            publisher.publish(&format!("hello {number}")).unwrap();
        }
        example.signal(Signal::SIGCONT);
        // Returns at once if the socket accepted all messages.
        assert!(publisher.flush_timeout(SOON).unwrap());
        let heard = example.output();
        assert_eq!(heard.lines().collect::<Vec<_>>(), hello(1..=150), "{name}");
    });
}

/// The node reconnects to the next Manager through its descriptors: the loop needs no timer for that.
#[test]
fn a_loop_meets_the_next_manager() {
    in_each_loop(&["1", NEVER], |domain, _, name, example| {
        domain.stop();
        domain.start();
        let node = domain.node("newcomer");
        let publisher = node.publisher::<str>("chatter").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        publisher.publish("hello again").unwrap();
        assert_eq!(example.output(), "newcomer said: hello again\n", "{name}");
    });
}

#[test]
fn ctrl_c_ends_a_loop() {
    in_each_loop(&[], |domain, _, name, example| {
        example.signal(Signal::SIGINT);
        let Output { status, stderr, .. } = example.finish();
        assert_eq!(status.code(), Some(130), "{name}");
        assert_eq!(String::from_utf8(stderr).unwrap(), "", "{name}");
        // The node said goodbye, so its name is free.
        domain.node(&name.replace('_', "-"));
    });
}
