//! The logs of `sm2 up`.

use std::{
    fs::File,
    io::{BufRead, BufReader, pipe},
};

use nix::sys::signal::Signal;

use crate::{
    common::{Running, until},
    up::Robot,
};

#[test]
fn lines_have_the_name_of_their_program() {
    let robot = Robot::new(
        "[program.a]\ncommand = ['printf', 'one\\n\\033[31mtwo\\033[0m\\n\\342\\200\\256three']\n\
         [program.longer]\ncommand = 'true'\n",
    );
    let plain = Running::start(&mut robot.command(&[])).finish();
    let text = plain.stdout();
    for line in [
        "a       | one",
        "a       | two",
        "a       | \\u{202e}three",
        "longer  * exited with status 0",
    ] {
        assert!(
            text.lines().any(|it| it.starts_with(line)),
            "{line} is not in\n{text}"
        );
    }
    assert!(!text.contains('\u{1b}'), "{text}");
    let coloured = Running::start(robot.command(&[]).env("CLICOLOR_FORCE", "1")).finish();
    assert!(
        coloured
            .stdout()
            .contains("\u{1b}[32ma       |\u{1b}[0m one\n"),
        "{coloured:?}"
    );
    let mut forbidden = robot.command(&[]);
    forbidden.env("CLICOLOR_FORCE", "1").env("NO_COLOR", "1");
    assert!(
        !Running::start(&mut forbidden)
            .finish()
            .stdout()
            .contains('\u{1b}')
    );
}

#[test]
fn a_slow_reader_does_not_stop_a_program() {
    let robot = Robot::new(
        "[program.a]\ncommand = ['sh', '-c', 'yes 0123456789012345678901234567890123456789 | head -n 200000; \
         touch done; exec sleep 1000']\n",
    );
    let (output, input) = pipe().unwrap();
    let mut command = robot.command(&["--json"]);
    let up = Running::start_into(command.stdout(input));
    // It holds the other end of the pipe.
    drop(command);
    until("the program has printed all", || {
        robot.path("done").exists()
    });
    up.signal(Signal::SIGINT);
    let lines: Vec<_> = BufReader::new(output).lines().map(Result::unwrap).collect();
    assert_eq!(up.finish().code(), 0);
    let logs = lines.iter().filter(|it| it.contains("\"log\"")).count();
    assert!(logs < 200_000, "{logs}");
    assert!(
        lines
            .iter()
            .any(|it| it.contains("dropped: the output is slower"))
    );
}

#[test]
fn a_full_disk_does_not_stop_a_program() {
    let robot = Robot::new("[program.a]\ncommand = ['sh', '-c', 'echo a; touch done']\n");
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut command = robot.command(&[]);
    let up = Running::start_into(command.stdout(full)).finish();
    let errors = up.stderr();
    assert_eq!(up.code(), 1, "{errors}");
    assert!(
        errors.contains("cannot write to standard output: No space left"),
        "{errors}"
    );
    assert!(robot.path("done").exists());
}
