//! `sm2 up`: order, restarts, and ends.

use std::{fs, path::PathBuf, process::Command};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde_json::Value;
use sm2_test_support::memory;
use tempfile::TempDir;

use crate::common::{Domain, Finished, Running, sm2, until};

/// A folder with a file of programs. In its text, `@sm2` stands for the command `sm2`.
pub(crate) struct Robot(TempDir);

impl Robot {
    pub(crate) fn new(text: &str) -> Self {
        let folder = tempfile::tempdir_in(memory()).unwrap();
        let text = text.replace("@sm2", env!("CARGO_BIN_EXE_sm2"));
        fs::write(folder.path().join("robot.toml"), text).unwrap();
        Self(folder)
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn command(&self, options: &[&str]) -> Command {
        let mut command = sm2(&["up"]);
        command.arg(self.path("robot.toml")).args(options);
        command.arg("--socket").arg(self.path("sm2.sock"));
        for variable in ["NO_COLOR", "CLICOLOR_FORCE"] {
            command.env_remove(variable);
        }
        command
    }

    fn start(&self) -> Running {
        Running::start(&mut self.command(&["--json"]))
    }

    fn run(&self) -> Finished {
        self.start().finish()
    }
}

fn events(text: &str) -> Vec<Value> {
    // The last line may not be complete.
    let lines = text.split_inclusive('\n').filter(|it| it.ends_with('\n'));
    lines.map(|it| serde_json::from_str(it).unwrap()).collect()
}

/// The events of a kind, with the name of the program.
fn programs(text: &str, kind: &str) -> Vec<String> {
    let events = events(text).into_iter().filter(|it| it["event"] == kind);
    let name = |it: Value| it["program"].as_str().unwrap_or("-").to_owned();
    events.map(name).collect()
}

/// The text of the first event of a kind and a program.
fn text_of(text: &str, program: &str, kind: &str) -> Option<String> {
    let mut events = events(text).into_iter();
    let event = events.find(|it| it["event"] == kind && it["program"] == program)?;
    event["text"].as_str().map(str::to_owned)
}

fn await_event(up: &Running, program: &str, kind: &str) -> String {
    let mut found = None;
    until(&format!("{program}: {kind}"), || {
        found = text_of(&up.stdout(), program, kind);
        found.is_some()
    });
    found.unwrap()
}

/// Waits for a line of a program that is a number.
fn await_number(up: &Running, program: &str) -> i32 {
    await_event(up, program, "log").parse().unwrap()
}

/// Whether a process is gone, or a zombie that nobody has reaped.
fn is_gone(pid: i32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let state = stat.rsplit_once(')').map(|(_, fields)| fields.trim_start());
    state.is_none_or(|it| it.starts_with(['Z', 'X']))
}

fn await_gone(pids: &[i32]) {
    until(&format!("{pids:?} end"), || {
        pids.iter().all(|it| is_gone(*it))
    });
}

#[test]
fn programs_start_when_their_conditions_hold_and_end_in_reverse_order() {
    let robot = Robot::new(
        "[program.second]\n\
         command = ['@sm2', 'topic', 'pub', 'map', '--value', '\"1\"', '--rate', '10', '--loop', '--wait', '0']\n\
         after = ['topic:scan publishers>=1']\n\
         [program.third]\ncommand = ['@sm2', 'topic', 'echo', 'map']\nafter = ['topic:map publishers>=1']\n\
         [program.first]\n\
         command = ['@sm2', 'topic', 'pub', 'scan', '--value', '\"1\"', '--rate', '10', '--loop', '--wait', '0']\n",
    );
    let up = robot.start();
    await_event(&up, "third", "started");
    up.signal(Signal::SIGINT);
    let up = up.finish();
    let text = up.stdout();
    assert_eq!((up.code(), up.stderr()), (0, String::new()), "{text}");
    assert_eq!(
        programs(&text, "started"),
        ["manager", "first", "second", "third"]
    );
    // The last one of the file ends first, and the Manager last.
    let ended = ["first", "third", "second", "manager"];
    assert_eq!(programs(&text, "stopping")[1..], ended);
    assert_eq!(programs(&text, "exited"), ended);
    let events = events(&text);
    assert!(events.iter().all(|it| it["event"] != "dropped"), "{text}");
    let waits = text_of(&text, "third", "waiting").unwrap();
    assert!(waits.starts_with("waits: "), "{waits}");
    let expected = "'topic:map publishers>=1' is not true: 0 publishers";
    assert!(waits.contains(expected), "{waits}");
    let keys: Vec<_> = events
        .iter()
        .map(|it| it.as_object().unwrap().len())
        .collect();
    assert!(keys.iter().all(|len| *len == 7), "one shape: {text}");
}

/// Each of them waits for the one before: a change of the domain that wakes nobody would cost seconds, and the more the
/// longer it takes.
#[test]
fn each_change_of_the_domain_counts_at_once() {
    let program = |at: usize| {
        let after = match at {
            0 => String::new(),
            at => format!("after = ['topic:t{} publishers>=1']\n", at - 1),
        };
        format!(
            "[program.p{at}]\ncommand = ['@sm2', 'topic', 'pub', 't{at}', '--value', '\"1\"', '--rate', '1', '--loop', \
             '--wait', '0']\n{after}"
        )
    };
    let robot = Robot::new(&(0..7).rev().map(program).collect::<String>());
    let up = robot.start();
    await_event(&up, "p6", "started");
    up.signal(Signal::SIGINT);
    assert_eq!(up.finish().code(), 0);
}

#[test]
fn a_manager_that_serves_is_left_to_run() {
    let domain = Domain::new();
    let robot = Robot::new("[program.a]\ncommand = 'true'\n");
    let mut up = sm2(&["up"]);
    up.arg(robot.path("robot.toml"))
        .args(["--json", "--socket"]);
    let up = Running::start(up.arg(domain.path("sm2.sock"))).finish();
    assert_eq!(up.code(), 0, "{up:?}");
    assert_eq!(programs(&up.stdout(), "started"), ["a"]);
    assert_eq!(domain.run(&["node", "list"]).code(), 0);
}

#[test]
fn nothing_is_said_about_a_manager_that_it_ends() {
    let robot = Robot::new("[program.a]\ncommand = 'true'\n");
    let up = robot.run();
    assert_eq!(up.code(), 0, "{up:?}");
    assert!(!up.stdout().contains("the Manager is gone"), "{up:?}");
    assert_eq!(programs(&up.stdout(), "exited"), ["a", "manager"]);
}

#[test]
fn no_manager_is_started_if_the_file_says_so() {
    let robot = Robot::new("manager = false\n[program.a]\ncommand = 'true'\n");
    let up = robot.run();
    up.failed(1, &["no Manager answers at", "sm2 manager --socket"]);
    assert_eq!(up.stdout(), "");
}

#[test]
fn a_manager_that_cannot_serve_ends_it() {
    let robot = Robot::new("[program.a]\ncommand = 'true'\n");
    let mut command = sm2(&["up", "--json", "--socket", "/proc/none/sm2.sock"]);
    let up = Running::start(command.arg(robot.path("robot.toml"))).finish();
    up.failed(1, &["the Manager has ended: see its lines above"]);
    assert!(text_of(&up.stdout(), "manager", "log").is_some(), "{up:?}");
    assert_eq!(programs(&up.stdout(), "started"), ["manager"]);
}

#[test]
fn the_policy_decides_about_restarts() {
    let robot = Robot::new(
        "[program.good]\ncommand = 'true'\n\
         [program.bad]\ncommand = 'false'\nmax_restarts = 1\n\
         [program.once]\ncommand = 'false'\nrestart = 'never'\n\
         [program.again]\ncommand = 'true'\nrestart = 'always'\nmax_restarts = 1\n",
    );
    let up = robot.run();
    let text = up.stdout();
    assert_eq!((up.code(), up.stderr()), (1, String::new()), "{text}");
    let count = |kind: &str, name: &str| {
        programs(&text, kind)
            .iter()
            .filter(|it| *it == name)
            .count()
    };
    let starts = ["good", "bad", "once", "again"].map(|it| count("started", it));
    assert_eq!(starts, [1, 2, 1, 2], "{text}");
    let failures = ["good", "bad", "once", "again"].map(|it| count("failed", it));
    assert_eq!(failures, [0, 1, 1, 1], "{text}");
    let restarting = text_of(&text, "bad", "restarting").unwrap();
    assert_eq!(restarting, "starts again in 500 ms (0 further restarts)");
    // By the times of the events: a busy machine only makes the pause longer.
    let time = |kind: &str, nth: usize| {
        let those = events(&text).into_iter();
        let mut those = those.filter(|it| it["event"] == kind && it["program"] == "bad");
        those.nth(nth).unwrap()["elapsed_s"].as_f64().unwrap()
    };
    let again = time("started", 1) - time("restarting", 0);
    assert!(again > 0.49, "{again}: {text}");
    let ended = events(&text)
        .into_iter()
        .find(|it| it["event"] == "exited" && it["program"] == "once");
    let ended = ended.unwrap();
    assert_eq!(
        (&ended["status"], &ended["signal"]),
        (&1.into(), &Value::Null)
    );
}

#[test]
fn a_program_that_is_killed_starts_again() {
    let robot = Robot::new("[program.a]\ncommand = ['sh', '-c', 'exec sleep 1000']\n");
    let up = robot.start();
    await_event(&up, "a", "started");
    let pid = |at: usize| {
        let starts = events(&up.stdout()).into_iter();
        let mut starts = starts.filter(|it| it["event"] == "started" && it["program"] == "a");
        starts.nth(at).and_then(|it| it["pid"].as_i64())
    };
    kill(Pid::from_raw(pid(0).unwrap() as i32), Signal::SIGKILL).unwrap();
    until("it is started again", || pid(1).is_some());
    let ended = events(&up.stdout())
        .into_iter()
        .find(|it| it["event"] == "exited")
        .unwrap();
    assert_eq!(
        (&ended["status"], &ended["signal"]),
        (&Value::Null, &9.into())
    );
    up.signal(Signal::SIGTERM);
    assert_eq!(up.finish().code(), 0);
}

#[test]
fn a_manager_that_is_killed_starts_again_and_the_programs_run() {
    let robot = Robot::new("[program.a]\ncommand = ['sleep', '1000']\n");
    let up = robot.start();
    await_event(&up, "a", "started");
    let managers = || {
        let starts = events(&up.stdout()).into_iter();
        let starts = starts.filter(|it| it["event"] == "started" && it["program"] == "manager");
        starts
            .map(|it| it["pid"].as_i64().unwrap() as i32)
            .collect::<Vec<_>>()
    };
    kill(Pid::from_raw(managers()[0]), Signal::SIGKILL).unwrap();
    until("a Manager is there again", || {
        up.stdout().contains("a Manager is there again")
    });
    assert_eq!(managers().len(), 2);
    up.signal(Signal::SIGINT);
    let up = up.finish();
    assert_eq!(up.code(), 0, "{up:?}");
    let of_a = events(&up.stdout())
        .into_iter()
        .filter(|it| it["program"] == "a");
    assert_eq!(of_a.filter(|it| it["event"] == "started").count(), 1);
}

/// A program that has started another one, which prints its number.
const WITH_CHILD: &str = "command = ['sh', '-c', 'sleep 1000 & echo $!; wait']\n";

#[test]
fn nothing_is_left_when_it_is_killed() {
    let robot = Robot::new(&format!("stop_timeout = '1h'\n[program.a]\n{WITH_CHILD}"));
    let up = robot.start();
    let child = await_number(&up, "a");
    let started = events(&up.stdout())
        .into_iter()
        .filter(|it| it["event"] == "started");
    let mut pids: Vec<_> = started
        .map(|it| it["pid"].as_i64().unwrap() as i32)
        .collect();
    assert_eq!(pids.len(), 2, "the Manager and the program");
    pids.push(child);
    up.signal(Signal::SIGKILL);
    await_gone(&pids);
}

#[test]
fn the_guard_is_replaced_and_kills_after_the_timeout() {
    let robot = Robot::new(
        "stop_timeout = '100ms'\n[program.a]\n\
         command = ['sh', '-c', 'trap \"\" TERM; echo $$; while :; do sleep 1000; done']\n",
    );
    let up = robot.start();
    let pid = await_number(&up, "a");
    let guard = |but: i32| {
        let tasks = format!("/proc/{0}/task/{0}/children", up.pid());
        let children = fs::read_to_string(tasks).unwrap();
        let mut children = children
            .split_whitespace()
            .map(|it| it.parse::<i32>().unwrap());
        children.find(|it| {
            let line = fs::read(format!("/proc/{it}/cmdline")).unwrap_or_default();
            *it != but
                && line
                    .split(|byte| *byte == 0)
                    .any(|word| word == b"up-guard")
        })
    };
    let first = guard(0).unwrap();
    kill(Pid::from_raw(first), Signal::SIGKILL).unwrap();
    let mut second = None;
    until("another guard", || {
        second = guard(first);
        second.is_some()
    });
    up.signal(Signal::SIGKILL);
    await_gone(&[pid, second.unwrap()]);
}

#[test]
fn a_program_that_ignores_the_end_is_killed() {
    let robot = Robot::new(
        "stop_timeout = '100ms'\n[program.a]\n\
         command = ['sh', '-c', 'trap \"\" TERM; echo $$; while :; do sleep 1000; done']\n",
    );
    let up = robot.start();
    let pid = await_number(&up, "a");
    up.signal(Signal::SIGTERM);
    let up = up.finish();
    assert_eq!(up.code(), 1, "{up:?}");
    let text = text_of(&up.stdout(), "a", "killing").unwrap();
    assert_eq!(text, "still runs 100 ms after SIGTERM: SIGKILL");
    assert!(is_gone(pid));
}

#[test]
fn a_second_signal_kills_at_once() {
    let robot = Robot::new(
        "stop_timeout = '1h'\n[program.a]\n\
         command = ['sh', '-c', 'trap \"\" TERM; echo $$; while :; do sleep 1000; done']\n\
         [program.b]\ncommand = ['sleep', '1000']\n",
    );
    let up = robot.start();
    let pid = await_number(&up, "a");
    up.signal(Signal::SIGINT);
    await_event(&up, "a", "stopping");
    // One that follows closely counts as the first one.
    until("a second signal counts", || {
        up.signal(Signal::SIGINT);
        up.stdout().contains("killing all programs")
    });
    let up = up.finish();
    assert_eq!(up.code(), 130, "{up:?}");
    assert!(is_gone(pid));
}

#[test]
fn processes_that_a_program_leaves_behind_are_ended() {
    let robot = Robot::new("[program.a]\ncommand = ['sh', '-c', 'sleep 1000 & echo $!']\n");
    let up = robot.run();
    assert_eq!(up.code(), 0, "{up:?}");
    let child = text_of(&up.stdout(), "a", "log").unwrap();
    assert!(is_gone(child.parse().unwrap()));
}

#[test]
fn a_program_gets_its_environment_and_folder() {
    let robot = Robot::new(
        "[program.a]\ncommand = ['sh', '-c', 'echo $SM2_PARAMS $SM2_SOCKET $PWD $X']\n\
         directory = 'work'\nparams = 'params.toml'\nenvironment = { X = 'y' }\n",
    );
    fs::create_dir(robot.path("work")).unwrap();
    fs::write(robot.path("params.toml"), "").unwrap();
    let up = robot.run();
    let [params, socket, work] = ["params.toml", "sm2.sock", "work"].map(|it| robot.path(it));
    let expected = format!(
        "{} {} {} y",
        params.display(),
        socket.display(),
        work.display()
    );
    assert_eq!(text_of(&up.stdout(), "a", "log"), Some(expected));
}

#[test]
fn a_wrong_file_starts_nothing() {
    let robot = Robot::new("[program.a]\ncommand = 'true'\nafter = ['topic:b']\n");
    let up = robot.run();
    up.failed(
        2,
        &["robot.toml:3:10: at character 8 (the end): expected a condition"],
    );
    assert!(!robot.path("sm2.sock").exists());
}

#[test]
fn units_are_written_instead_of_starting_programs() {
    let robot = Robot::new("[program.a]\ncommand = 'true'\nafter = ['topic:b publishers>0']\n");
    let folder = robot.path("units");
    let up = Running::start(&mut robot.command(&["--systemd", folder.to_str().unwrap()])).finish();
    assert_eq!(up.code(), 0, "{up:?}");
    let paths =
        ["robot-manager.service", "robot-a.service", "robot.target"].map(|it| folder.join(it));
    let lines = paths
        .each_ref()
        .map(|it| format!("{}\n", it.display()))
        .concat();
    assert_eq!(up.stdout(), lines);
    assert!(up.stderr().contains("systemctl --user start robot.target"));
    assert!(
        fs::read_to_string(&paths[1])
            .unwrap()
            .contains("topic:b publishers>0")
    );
    assert!(!robot.path("sm2.sock").exists());
}
