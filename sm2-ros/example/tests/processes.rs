//! Two processes exchange messages of ROS 2, and one of a package of their own.

use std::process::{Child, Command};

use sm2_manager::{Background, Options};

const EXPECTED: &str = "\
header.stamp.sec: 7
header.stamp.nanosec: 0
header.frame_id: front
height: 2
width: 3
encoding: mono8
is_bigendian: 0
step: 3
data: [1, 2, 3, 4, 5, 6]
header.frame_id: front
side: 1
speed: 1.5
type: steel
accepted: false
reason: too fast
";

/// Ends the process at the end of the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn one_process_prints_the_fields_that_another_publishes() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("domain.sock");
    let _manager = Background::start(&socket, Options::default()).unwrap();
    let program = |role| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-ros-example"));
        command.arg(role).env("SM2_SOCKET", &socket);
        command
    };
    let _publisher = Running(program("publish").spawn().unwrap());
    let echo = program("echo").output().unwrap();
    assert!(echo.status.success(), "{echo:?}");
    assert_eq!(String::from_utf8(echo.stdout).unwrap(), EXPECTED);
}

/// The comments of a definition are in the documentation of its type.
#[test]
fn the_generated_types_have_the_comments() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/msgs/my_msgs");
    let code = sm2_ros_build::Builder::new()
        .package(folder)
        .code()
        .unwrap();
    for comment in [
        "The state of one wheel.",
        "radians per second,",
        "positive forwards",
    ] {
        assert!(code.contains(comment), "{comment}");
    }
}
