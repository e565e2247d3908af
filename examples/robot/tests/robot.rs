//! The whole robot, as `sm2 up` starts it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use sm2_example_robot::{DetectorState, Image, Map, Stop};
use sm2_node::params::{Assignment, SetParameters, SetParametersResult, Value};
use sm2_node::{Node, Subscriber};
use sm2_test_support::{SOON, until};

/// `sm2 up`. When it ends, it ends its programs, and its guard does so when it is killed.
struct Up(Child);

impl Up {
    /// Ends it as Ctrl-C does. Returns its exit status.
    fn end(&mut self) -> Option<i32> {
        let pid = Pid::from_raw(self.0.id().try_into().unwrap());
        kill(pid, Signal::SIGINT).unwrap();
        let mut status = None;
        until("sm2 up ends", || {
            status = self.0.try_wait().unwrap();
            status.is_some()
        });
        status.and_then(|it| it.code())
    }
}

impl Drop for Up {
    fn drop(&mut self) {
        let _ = self.0.kill();
    }
}

/// The folder of the programs that this test was built with.
fn programs() -> PathBuf {
    let camera = Path::new(env!("CARGO_BIN_EXE_camera"));
    camera.parent().unwrap().to_owned()
}

/// Starts the robot of this folder in a domain of the test's own.
fn start(folder: &Path, socket: &Path) -> Up {
    let sm2 = programs().join("sm2");
    assert!(
        sm2.is_file(),
        "no {}: build it with `cargo build -p sm2-cli`",
        sm2.display()
    );
    let ours = Path::new(env!("CARGO_MANIFEST_DIR"));
    let robot = fs::read_to_string(ours.join("robot.toml")).unwrap();
    let robot = robot.replace("../../target/release", programs().to_str().unwrap());
    fs::write(folder.join("robot.toml"), robot).unwrap();
    fs::copy(ours.join("params.toml"), folder.join("params.toml")).unwrap();
    let mut command = Command::new(sm2);
    command.arg("up").arg(folder.join("robot.toml"));
    command.arg("--socket").arg(socket).stdout(Stdio::null());
    Up(command.spawn().unwrap())
}

/// Waits for the first message that makes `is_it` true.
fn await_speed(speeds: &Subscriber<f64>, is_it: impl Fn(f64) -> bool) {
    loop {
        let speed = speeds.recv_timeout(SOON).unwrap().expect("a speed");
        if is_it(*speed) {
            return;
        }
    }
}

/// README has the number of the lines that are neither empty nor comments.
#[test]
fn readme_counts_the_lines_of_the_programs() {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = vec![ours.join("src/lib.rs")];
    let programs = fs::read_dir(ours.join("src/bin")).unwrap();
    files.extend(programs.map(|it| it.unwrap().path()));
    let texts = files.iter().map(|it| fs::read_to_string(it).unwrap());
    let is_code = |line: &&str| !line.trim().is_empty() && !line.trim().starts_with("//");
    let lines: usize = texts.map(|it| it.lines().filter(is_code).count()).sum();
    let readme = fs::read_to_string(ours.join("../../README.md")).unwrap();
    let text = format!("six programs in {lines} lines");
    assert!(readme.contains(&text), "README lacks {text:?}");
}

#[test]
fn the_map_comes_and_an_emergency_stops_the_motor() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("sm2.sock");
    let mut up = start(folder.path(), &socket);
    let node = Node::builder("test").socket(&socket);
    let node = node.startup_timeout(SOON).connect().unwrap();

    let maps = node.subscriber::<Map>("map").unwrap();
    let map = maps.recv_timeout(SOON).unwrap().expect("a map");
    assert_eq!(map.obstacles.len(), 1);
    let speeds = node.subscriber::<f64>("motor/speed").unwrap();
    await_speed(&speeds, |it| it > 0.0);
    // Each image of 5 ms has this dark wall: the value of params.toml.
    let images = node.subscriber::<Image>("camera/image").unwrap();
    let image = images.recv_timeout(SOON).unwrap().expect("an image");
    assert_eq!(image.pixels.last(), Some(&20));
    let states = node.client::<str, DetectorState>("detector/state").unwrap();
    let state = states.call_timeout("", SOON).unwrap();
    assert!(state.images > 0 && state.objects > 0);

    let emergency = node.client::<Stop, str>("emergency/set").unwrap();
    let set = |on| {
        let reason = "a test".to_owned();
        emergency.call_timeout(&Stop { on, reason }, SOON).unwrap();
    };
    set(true);
    await_speed(&speeds, |it| it == 0.0);
    let client = node.client::<SetParameters, SetParametersResult>("parameters/motor");
    let client = client.unwrap();
    let set_max_speed = |value| {
        let assignment = Assignment {
            name: "max_speed".to_owned(),
            value: Value::Double(value),
        };
        let request = SetParameters {
            parameters: vec![assignment],
        };
        let result = client.call_timeout(&request, SOON).unwrap();
        (result.successful, result.reason.clone())
    };
    let (is_set, reason) = set_max_speed(2.0);
    assert!(
        !is_set && reason.contains("an emergency stop is on"),
        "{reason}"
    );
    set(false);
    await_speed(&speeds, |it| it > 0.0);
    assert_eq!(set_max_speed(0.25), (true, String::new()));
    await_speed(&speeds, |it| it == 0.25);

    assert_eq!(up.end(), Some(0));
}
