use std::{process::Command, time::Duration};

use super::*;
use crate::{up::robot::RestartPolicy, wait_for::Expression};

fn robot() -> Robot {
    let program = |name: &str, command: &[&str], after: &[&str]| Program {
        name: name.to_owned(),
        command: command.iter().copied().map(str::to_owned).collect(),
        folder: "/tmp".into(),
        environment: vec![],
        policy: RestartPolicy::OnFailure,
        max_restarts: 5,
        after: after
            .iter()
            .map(|it| Expression::parse(it).unwrap())
            .collect(),
    };
    let mut map = program(
        "map",
        &["/bin/echo", "a \"b\" $HOME 100%\\"],
        &["topic:scan publishers>=1"],
    );
    map.environment = vec![(
        "SM2_PARAMS".to_owned(),
        "/etc/my robot/100%.toml".to_owned(),
    )];
    map.policy = RestartPolicy::Never;
    Robot {
        name: "my robot".to_owned(),
        domain: None,
        has_manager: true,
        stop_timeout: Duration::from_millis(1_500),
        programs: vec![program("lidar", &["/bin/true"], &[]), map],
    }
}

fn write(robot: &Robot, folder: &Path) -> Result<Ended, CliError> {
    let units = Units {
        robot,
        itself: Path::new("/bin/true"),
        socket: Path::new("/run/sm2/default.sock"),
    };
    units.write(Some(folder))
}

#[test]
fn a_unit_says_what_the_file_says() {
    let folder = tempfile::tempdir().unwrap();
    write(&robot(), folder.path()).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    let map = read("my_robot-map.service");
    for line in [
        "Description=map of robot my robot",
        "PartOf=my_robot.target",
        "After=my_robot-manager.service",
        "StartLimitIntervalSec=360",
        "StartLimitBurst=6",
        "WorkingDirectory=/tmp",
        "Environment=\"SM2_SOCKET=/run/sm2/default.sock\"",
        "Environment=\"SM2_PARAMS=/etc/my robot/100%%.toml\"",
        "ExecStartPre=\"/bin/true\" \"wait\" \"--socket\" \"/run/sm2/default.sock\" \"--wait-manager\" \"8760h\" \
         \"topic:scan publishers>=1\"",
        "TimeoutStartSec=infinity",
        "ExecStart=\"/bin/echo\" \"a \\\"b\\\" $$HOME 100%%\\\\\"",
        "Restart=no",
        "TimeoutStopSec=1500ms",
    ] {
        assert!(map.lines().any(|it| it == line), "{line} is not in\n{map}");
    }
    let lidar = read("my_robot-lidar.service");
    assert!(!lidar.contains("ExecStartPre"), "{lidar}");
    assert!(lidar.contains("Restart=on-failure\n"), "{lidar}");
    let manager = read("my_robot-manager.service");
    assert!(
        manager.contains("\"manager\" \"--standby\" \"--socket\" \"/run/sm2/default.sock\"\n"),
        "{manager}"
    );
    let target = read("my_robot.target");
    let wants = "Wants=my_robot-manager.service my_robot-lidar.service my_robot-map.service\n";
    assert!(target.contains(wants), "{target}");
}

#[test]
fn systemd_accepts_the_units() {
    let folder = tempfile::tempdir().unwrap();
    write(&robot(), folder.path()).unwrap();
    let mut verify = Command::new("systemd-analyze");
    verify.args(["verify", "--user"]);
    verify.arg(folder.path().join("my_robot.target"));
    let verify = verify.env("XDG_RUNTIME_DIR", folder.path()).output();
    match verify {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && text.is_empty(), "{text}");
        }
        Err(error) => sm2_test_support::skip_without("systemd-analyze", error),
    }
}

#[test]
fn only_its_own_units_are_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let mut robot = robot();
    write(&robot, folder.path()).unwrap();
    robot.stop_timeout = Duration::from_secs(9);
    write(&robot, folder.path()).unwrap();
    let path = folder.path().join("my_robot-map.service");
    let map = fs::read_to_string(&path).unwrap();
    assert!(map.contains("TimeoutStopSec=9000ms\n"), "{map}");
    fs::write(&path, "[Service]\n").unwrap();
    robot.stop_timeout = Duration::from_secs(8);
    let error = write(&robot, folder.path()).unwrap_err();
    assert!(error.to_string().contains("has not written it"), "{error}");
    // Nothing was written before the refusal.
    let lidar = fs::read_to_string(folder.path().join("my_robot-lidar.service")).unwrap();
    assert!(lidar.contains("TimeoutStopSec=9000ms\n"), "{lidar}");
}
