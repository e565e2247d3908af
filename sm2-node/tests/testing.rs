//! Domains for tests.

use std::fs;
use std::process::Stdio;

use crate::common::SOON;
use sm2_node::testing::{TestDomain, TestDomainError};

/// The names of the folders that test domains of this process have left.
fn left() -> Vec<String> {
    let begin = format!("sm2-test-{}-", std::process::id());
    let entries = fs::read_dir(std::env::temp_dir()).unwrap();
    let names = entries.map(|it| it.unwrap().file_name().into_string().unwrap_or_default());
    names.filter(|it| it.starts_with(&begin)).collect()
}

/// Two domains at the same time do not see each other, and no file is left even while they exist.
#[test]
fn test_domains_are_private_and_leave_no_file() {
    let (one, other) = (TestDomain::new().unwrap(), TestDomain::new().unwrap());
    let builder = |domain: &TestDomain| domain.builder("same").manager_timeout(SOON);
    let (first, second) = (
        builder(&one).connect().unwrap(),
        builder(&other).connect().unwrap(),
    );
    let peer = one.builder("peer").manager_timeout(SOON).connect().unwrap();
    let publisher = first.publisher::<u64>("topic").unwrap();
    let (near, far) = (
        peer.subscriber::<u64>("topic").unwrap(),
        second.subscriber::<u64>("topic").unwrap(),
    );
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    assert_eq!(far.matched(), 0);
    publisher.publish(&7).unwrap();
    assert_eq!(*near.recv_timeout(SOON).unwrap().unwrap(), 7);
    // Another test may be about to make one.
    crate::common::until(|| left().is_empty());
    assert!(!one.socket().starts_with(std::env::temp_dir()));
}

/// A program that a test starts connects to the domain of the test.
#[test]
fn a_program_connects_to_the_domain_of_its_test() {
    let domain = TestDomain::new().unwrap();
    let listener = domain
        .builder("test")
        .manager_timeout(SOON)
        .connect()
        .unwrap();
    let heard = listener.subscriber::<str>("chatter").unwrap();
    let talker = super::examples::path("talker");
    let mut child = domain
        .command(talker)
        .arg("1")
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let sample = heard
        .recv_timeout(SOON)
        .unwrap()
        .expect("a message of the program");
    assert_eq!(&*sample, "hello 1");
    let mut status = None;
    crate::common::until(|| {
        status = child.try_wait().unwrap();
        status.is_some()
    });
    assert!(status.unwrap().success());
}

#[test]
fn a_folder_that_does_not_exist_is_named() {
    let error = TestDomainError::Folder {
        path: "/nowhere".into(),
        source: std::io::ErrorKind::NotFound.into(),
    };
    let text = error.to_string();
    assert!(
        text.contains("\"/nowhere\"") && text.contains("TMPDIR"),
        "{text}"
    );
}
