//! A subscriber that a new access policy denies, and that does not obey: what it can read in the memory that it mapped.

use std::{
    fs::{self, File},
    os::unix::fs::FileExt as _,
};

use sm2_proto::{Farewell, control::ToNode};
use sm2_tests::{
    control::{self, Qos},
    link::{kind, release, role},
    raw::{RawLink, RawNode},
};

use crate::common::{Domain, until};

const DENY: &str = "\
default = \"allow\"

[[rule]]
effect = \"deny\"
actions = [\"subscribe\"]
names = [\"**\"]
nodes = [\"spy\"]
";

fn content(file: &File) -> Vec<u8> {
    let mut bytes = vec![0; usize::try_from(file.metadata().unwrap().len()).unwrap()];
    file.read_exact_at(&mut bytes, 0).unwrap();
    bytes
}

/// Takes three messages and releases them. Returns the segments that came along.
fn segments(link: &RawLink) -> Vec<File> {
    let mut files = Vec::new();
    let mut messages = 0;
    while messages < 3 {
        let frame = link.end.expect();
        if frame.bytes[0] == kind::DATA {
            messages += 1;
            let sequence = u64::from_le_bytes(frame.bytes[16..24].try_into().unwrap());
            // Its slot may serve the next message.
            link.end.send(release(0, &[sequence]));
        }
        files.extend(frame.fds.into_iter().map(File::from));
    }
    files
}

/// Once `sm2 policy reload` has returned, the publisher's program writes nothing to the memory that the spy maps.
//= SM2-ACC-015 sys
#[test]
fn a_denied_subscriber_reads_nothing_more_from_its_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let policy = folder.path().join("policy.toml");
    fs::write(&policy, "default = \"allow\"\n").unwrap();
    let domain = Domain::with(&["--policy", policy.to_str().unwrap()]);
    let frame = domain.path("frame");
    fs::write(&frame, vec![7; 100_000]).unwrap();
    let publish = [
        "topic",
        "pub",
        "t",
        "--from",
        frame.to_str().unwrap(),
        "--loop",
        "--rate",
        "100",
    ];
    let _talker = domain.start(&publish);
    domain.wait_for("t", "publishers", 1);
    let spy = RawNode::welcomed(&domain.path("sm2.sock"), "spy");
    spy.declare(1, &control::subscriber("t", Qos::PLAIN));
    let link = spy.linked();
    link.open(role::RECEIVER, 4);
    let listener = domain.node("listener");
    let honest = listener.subscriber::<[u8]>("t").unwrap();
    let receive = |count| {
        for _ in 0..count {
            let message = honest.recv_timeout(sm2_test_support::SOON).unwrap();
            assert_eq!(message.expect("a message").len(), 100_000);
        }
    };
    receive(3);
    let mut files = segments(&link);
    assert!(!files.is_empty(), "the messages are in segments");

    fs::write(&policy, DENY).unwrap();
    let reload = domain.start(&["policy", "reload"]);
    for _ in 0..2 {
        match spy.next() {
            ToNode::DeclareRefused { .. } => spy.send(control::suspended(1)),
            ToNode::Unlink { link, code, .. } => {
                assert_eq!(code, Farewell::Denied.code());
                spy.send(control::unlinked(1, link, code.0));
            }
            other => panic!("{other:?}"),
        }
    }
    let finished = reload.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    // Segments that came before the end of the link.
    while let Some(Some(frame)) = link.end.try_recv() {
        files.extend(frame.fds.into_iter().map(File::from));
    }
    let before: Vec<_> = files.iter().map(content).collect();
    receive(50);
    let after: Vec<_> = files.iter().map(content).collect();
    assert!(before == after, "a denied process has read on");
    until("the topic goes on", || {
        honest
            .recv_timeout(sm2_test_support::SOON)
            .unwrap()
            .is_some()
    });
}
