//! An owner that is killed. In its own file: a child process holds copies of all descriptors until it calls
//! `exec`, which would disturb other tests.

use sm2_test_support::ran_alone;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use sm2_io::{BindOptions, DomainSocketError, SeqPacket};

const PATH_OF_VICTIM: &str = "SM2_IO_TEST_VICTIM";

#[test]
fn an_owner_that_is_killed_gives_way() {
    if ran_alone(concat!(
        module_path!(),
        "::an_owner_that_is_killed_gives_way"
    )) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sm2/default.sock");
    let mut victim = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "killed::the_victim", "--ignored", "--nocapture"])
        .env(PATH_OF_VICTIM, &path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(victim.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().ends_with("claimed")));
    assert!(SeqPacket::connect(&path).is_ok());
    assert!(matches!(
        BindOptions::acquire(&path),
        Err(DomainSocketError::Busy { .. })
    ));

    victim.kill().unwrap(); // SIGKILL: the process cannot clean up.
    victim.wait().unwrap();
    assert!(path.exists());
    assert!(SeqPacket::connect(&path).is_err());
    let endpoint = BindOptions::acquire(&path).unwrap();
    assert!(SeqPacket::connect(&path).is_ok());
    drop(endpoint);
    let left = path.parent().unwrap().read_dir().unwrap();
    assert_eq!(left.count(), 0);
}

#[test]
#[ignore = "runs in a child process of another test"]
fn the_victim() {
    let Some(path) = std::env::var_os(PATH_OF_VICTIM) else {
        return;
    };
    let _endpoint = BindOptions::acquire(path.as_ref()).unwrap();
    println!("claimed");
    loop {
        std::thread::park();
    }
}
