//! Every example, as a user runs it.

mod common;

use std::io::Read;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use common::{Domain, SOON};

fn start(domain: &Domain, name: &str, arguments: &[&str]) -> Child {
    Command::new(path(name))
        .args(arguments)
        .env("SM2_SOCKET", domain.socket())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn path(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test.ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(
        path.exists(),
        "{path:?} is built by: cargo test -p sm2-node"
    );
    path
}

/// What it printed, once it has ended well.
fn output(mut child: Child) -> String {
    let deadline = Instant::now() + SOON;
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if Instant::now() > deadline {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    };
    let mut text = String::new();
    child
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut text)
        .unwrap();
    assert!(status.success(), "{status}: {text}");
    text
}

#[test]
fn talker_and_listener() {
    let domain = Domain::new();
    let talker = start(&domain, "talker", &["3"]);
    let listener = start(&domain, "listener", &["3"]);
    let heard = output(listener);
    assert_eq!(
        heard.lines().collect::<Vec<_>>(),
        [
            "talker said: hello 1",
            "talker said: hello 2",
            "talker said: hello 3"
        ]
    );
    output(talker);
}

#[test]
fn camera() {
    let text = output(start(&Domain::new(), "camera", &["5"]));
    assert_eq!(text.lines().count(), 5);
    assert!(text.contains("1920 x 1080, brightness 4, "), "{text}");
}

#[test]
fn add_server_and_client() {
    let domain = Domain::new();
    let server = start(&domain, "add_server", &["1"]);
    let client = start(&domain, "add_client", &["1", "2.5", "4"]);
    assert_eq!(output(client), "add-server says 7.5\n");
    assert!(output(server).contains("[1.0, 2.5, 4.0]"));
}

#[test]
fn map_latched() {
    let text = output(start(&Domain::new(), "map_latched", &[]));
    assert!(text.contains("dock at 7.25, 0"), "{text}");
}
