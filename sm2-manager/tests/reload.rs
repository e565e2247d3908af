//! Another access policy for a Manager that serves.

// Shows ACC-RELOAD (test), bound: cases, with real processes.

use crate::common;
use std::{
    fs::{self, Permissions},
    os::unix::fs::PermissionsExt,
    path::Path,
    time::Duration,
};

use crate::common::{Program, TestDomain, eventually};
use nix::sys::signal::Signal;
use sm2_manager::{Background, Options};
use sm2_node::{
    Node, Publisher, Subscriber,
    domain::{PolicyProblem, ReloadError},
};
use sm2_test_support::SOON;

const OPEN: &str = "default = \"allow\"\n";
const QUIET: &str = "\
default = \"allow\"

[[rule]]
name = \"quiet\"
effect = \"deny\"
actions = [\"publish\"]
names = [\"numbers\"]
";

fn write(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o644)).unwrap();
}

struct Stream {
    talker: Node,
    listener: Node,
    publisher: Publisher<u64>,
    subscriber: Subscriber<u64>,
}

impl Stream {
    fn new(domain: &TestDomain, sealed: bool) -> Self {
        let connect = |name: &str| {
            let builder = Node::builder(name).socket(domain.socket());
            builder.manager_timeout(common::SOON).connect().unwrap()
        };
        let (talker, listener) = (connect("talker"), connect("listener"));
        let publisher = talker.publisher_builder("numbers").sealed(sealed).depth(8);
        let subscriber = listener.subscriber_builder("numbers").depth(8);
        Self {
            publisher: publisher.declare().unwrap(),
            subscriber: subscriber.declare().unwrap(),
            talker,
            listener,
        }
    }

    fn spin(&self) {
        for node in [&self.talker, &self.listener] {
            node.spin_once_timeout(Duration::from_millis(1)).unwrap();
        }
    }

    fn links(&self) -> usize {
        let links = self.publisher.links();
        links.iter().filter(|it| it.open).count()
    }

    #[track_caller]
    fn until(&self, what: &str, done: impl Fn() -> bool) {
        eventually(what, || {
            self.spin();
            done()
        });
    }

    /// Publishes messages that the subscriber does not take.
    fn publish(&self, count: u64) {
        self.until("linked", || self.links() == 1);
        for number in 0..count {
            self.publisher.publish(&number).unwrap();
        }
        self.spin();
    }

    fn take(&self) -> Option<u64> {
        self.subscriber.try_recv().unwrap().map(|it| *it)
    }
}

fn count(manager: &Program, text: &str) -> usize {
    manager.stderr().matches(text).count()
}

/// Once the Manager says that the policy is applied, nothing comes that the policy denies.
//= SM2-ACC-013, SM2-ACC-014, SM2-ACC-012 sys
#[test]
fn what_the_new_policy_denies_is_not_delivered() {
    for sealed in [false, true] {
        let domain = TestDomain::new();
        let file = domain.folder().join("robot.toml");
        write(&file, OPEN);
        let manager = domain.manager(&["--policy", file.to_str().unwrap()]);
        let stream = Stream::new(&domain, sealed);
        stream.publish(1);
        stream.until("a message", || stream.take() == Some(0));
        stream.publish(3);
        write(&file, QUIET);
        manager.signal(Signal::SIGHUP);
        let applied = "the new access policy is applied";
        stream.until(applied, || count(&manager, applied) == 1);
        assert_eq!(stream.take(), None, "sealed: {sealed}");
        assert_eq!(
            stream.subscriber.lost(),
            3,
            "the messages that were not taken"
        );
        assert!(!stream.publisher.is_registered() && stream.subscriber.is_registered());
        stream.publisher.publish(&7).unwrap();
        stream.spin();
        assert_eq!(stream.take(), None);
        // A policy that cannot be used changes nothing.
        write(&file, "default = \"all\"");
        manager.signal(Signal::SIGHUP);
        manager.says("the one before stays in force");
        manager.says("unknown variant `all`");
        assert!(stream.talker.publisher::<u64>("numbers").is_err());
        write(&file, OPEN);
        manager.signal(Signal::SIGHUP);
        stream.until(applied, || count(&manager, applied) == 2);
        stream.until("allowed again", || stream.publisher.is_registered());
        stream.publish(1);
        stream.until("a message", || stream.take() == Some(0));
    }
}

/// A domain gets its first policy while it runs, from a Manager that a program embeds, and loses it again.
//= SM2-ACC-013 sys
#[test]
fn a_policy_comes_and_goes() {
    let domain = TestDomain::new();
    let manager = Background::start(&domain.socket(), Options::default()).unwrap();
    let stream = Stream::new(&domain, false);
    stream.publish(1);
    let file = domain.folder().join("domain.sock.policy");
    write(&file, QUIET);
    manager.policy_reload().start();
    stream.until("denied", || !stream.publisher.is_registered());
    stream.until("unlinked", || stream.links() == 0);
    fs::remove_file(&file).unwrap();
    manager.policy_reload().start();
    stream.until("allowed", || stream.publisher.is_registered());
    stream.publish(1);
    manager.stop().unwrap();
}

/// A node of the Manager's user has the policy read again. The call returns when the policy is applied.
//= SM2-ACC-016, SM2-ACC-017 sys
#[test]
fn a_node_has_the_policy_read_again() {
    let domain = TestDomain::new();
    let manager = Background::start(&domain.socket(), Options::default()).unwrap();
    let tool = Node::builder("tool").socket(domain.socket());
    let tool = tool.manager_timeout(common::SOON).connect().unwrap();
    let reload = || tool.reload_policy(common::SOON);
    assert!(matches!(reload(), Err(ReloadError::NoPolicy)));
    let stream = Stream::new(&domain, false);
    stream.publish(3);
    let file = domain.folder().join("domain.sock.policy");
    write(&file, QUIET);
    reload().unwrap();
    assert_eq!(stream.take(), None);
    assert!(!stream.publisher.is_registered());
    assert_eq!(stream.subscriber.lost(), 3);
    write(&file, "default = \"all\"");
    let Err(ReloadError::Unusable { problem, text }) = reload() else {
        panic!("it is not a policy");
    };
    assert_eq!(problem, PolicyProblem::Invalid);
    assert!(text.contains(":1: unknown variant `all`"), "{text}");
    fs::set_permissions(&file, Permissions::from_mode(0o666)).unwrap();
    let refused = reload();
    assert!(
        matches!(
            &refused,
            Err(ReloadError::Unusable {
                problem: PolicyProblem::NotTrusted,
                ..
            })
        ),
        "{refused:?}"
    );
    fs::remove_file(&file).unwrap();
    fs::create_dir(&file).unwrap();
    let refused = reload();
    assert!(
        matches!(
            &refused,
            Err(ReloadError::Unusable {
                problem: PolicyProblem::Unreadable,
                ..
            })
        ),
        "{refused:?}"
    );
    assert!(!stream.publisher.is_registered(), "the policy before stays");
    fs::remove_dir(&file).unwrap();
    reload().unwrap();
    stream.publish(1);
    manager.stop().unwrap();
}

const WITHOUT_OTHER: &str = "\
default = \"allow\"

[[rule]]
effect = \"deny\"
actions = [\"subscribe\"]
names = [\"frames\"]
nodes = [\"other\"]
";

/// A loan that was taken before its segment was replaced is published from another one.
//= SM2-ACC-015 sys
#[test]
fn a_loan_outlasts_the_denial_of_another_subscriber() {
    let domain = TestDomain::new();
    let manager = Background::start(&domain.socket(), Options::default()).unwrap();
    let connect = |name: &str| {
        let builder = Node::builder(name).socket(domain.socket());
        let builder = builder.manager_timeout(SOON).background(true);
        builder.connect().unwrap()
    };
    let [talker, listener, other] = ["talker", "listener", "other"].map(connect);
    let publisher = talker.publisher::<[u8]>("frames").unwrap();
    let allowed = listener.subscriber_builder::<[u8]>("frames").depth(8);
    let allowed = allowed.declare().unwrap();
    let denied = other.subscriber::<[u8]>("frames").unwrap();
    publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
    let mut loan = publisher.loan_slice(10_000).unwrap();
    loan.fill(1);
    write(&domain.folder().join("domain.sock.policy"), WITHOUT_OTHER);
    talker.reload_policy(SOON).unwrap();
    let open = publisher.links().iter().filter(|it| it.open).count();
    assert!(!denied.is_registered() && open == 1);
    loan[9_999] = 2;
    loan.publish().unwrap();
    publisher.publish(&[3; 10_000]).unwrap();
    let take = || allowed.recv_timeout(SOON).unwrap().unwrap();
    let first = take();
    assert!(first[..9_999].iter().all(|&it| it == 1) && first[9_999] == 2);
    assert!(take().iter().all(|&it| it == 3));
    manager.stop().unwrap();
}
