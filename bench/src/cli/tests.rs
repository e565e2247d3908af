use super::{Cli, Command};
use crate::job::Read;
use clap::{CommandFactory, Parser};

fn parsed(line: &str) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(line.split_whitespace())
}

fn run(line: &str) -> super::RunArguments {
    match parsed(line).unwrap().command {
        Command::Run(arguments) => arguments,
        other => panic!("{other:?}"),
    }
}

fn complaint(line: &str) -> String {
    parsed(line).unwrap_err().to_string()
}

#[test]
fn the_command_line_is_sound() {
    Cli::command().debug_assert();
}

#[test]
fn a_run_is_understood() {
    let arguments = run(
        "sm2-bench run fig4-max --read header --peers sm2,raw-futex --repeats 7 --json \
         --seconds 0.5 --size 1_000",
    );
    assert_eq!(arguments.workload.name, "fig4-max");
    assert_eq!(arguments.read, Read::Header);
    let peers: Vec<_> = arguments.peers.iter().map(|peer| peer.name).collect();
    assert_eq!(peers, ["sm2", "raw-futex"]);
    assert_eq!((arguments.repeats, arguments.size), (7, 1_000));
    assert!(arguments.json && arguments.seconds == Some(0.5));
}

#[test]
fn without_options_every_byte_is_read_on_all_peers() {
    let arguments = run("sm2-bench run fig3");
    assert_eq!(arguments.read, Read::Full);
    assert!(arguments.peers.is_empty() && !arguments.json);
    assert_eq!(arguments.size, 10_000_000);
}

#[test]
fn what_is_unknown_is_refused_with_what_there_is() {
    assert!(complaint("sm2-bench run fig9").contains("pingpong"));
    assert!(complaint("sm2-bench run fig3 --peers sm2,nobody").contains("raw-futex"));
}

#[test]
fn numbers_that_make_no_sense_are_refused() {
    for wrong in [
        "--repeats 0",
        "--seconds 0",
        "--seconds x",
        "--size 31",
        "--nodes 1",
        "--read some",
        "--folder /dev/shm",
        "--folder /nowhere",
        "--gigabytes 0",
        "--gigabytes x",
        "--frame-rate 0",
    ] {
        assert!(
            parsed(&format!("sm2-bench run nodes {wrong}")).is_err(),
            "{wrong}"
        );
    }
}

#[test]
fn a_recording_is_understood() {
    let arguments = run("sm2-bench run record --folder / --gigabytes 0.5 --frame-rate 30");
    assert_eq!(arguments.folder, Some("/".into()));
    assert_eq!(arguments.gigabytes, Some(0.5));
    assert_eq!(arguments.frame_rate, Some(30.0));
    let complaint = complaint("sm2-bench run record --folder /dev/shm");
    assert!(complaint.contains("in memory"), "{complaint}");
}
