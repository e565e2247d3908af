//! `sm2 doctor`.

use std::{fs, os::unix::fs::PermissionsExt};

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::common::{Domain, Finished, Running, listener, sm2, until};

fn report(finished: &Finished) -> Value {
    serde_json::from_str(&finished.stdout()).unwrap()
}

/// The result of one check.
fn check<'a>(report: &'a Value, name: &str) -> &'a Value {
    let mut checks = report["checks"].as_array().unwrap().iter();
    checks.find(|it| it["check"] == name).unwrap()
}

#[test]
fn a_domain_that_works_has_nothing_bad() {
    let domain = Domain::new();
    let doctor = domain.run(&["doctor", "--json"]);
    assert_eq!(doctor.code(), 0, "{doctor:?}");
    let report = report(&doctor);
    assert_ne!(report["level"], "bad");
    for name in [
        "Manager",
        "quotas",
        "resuming nodes",
        "leftovers",
        "shared memory",
        "kernel",
    ] {
        assert_eq!(check(&report, name)["level"], "ok", "{report:#}");
    }
    let manager = check(&report, "Manager")["found"].as_str().unwrap();
    let uid = nix::unistd::geteuid();
    let process = format!(
        "process {} of user {uid}, protocol version 1, epoch ",
        domain.manager_pid()
    );
    assert!(manager.starts_with(&process), "{manager}");
    assert_eq!(check(&report, "standby")["level"], "warn");
    for it in report["checks"].as_array().unwrap() {
        assert_eq!(it["level"] == "ok", it["advice"].is_null(), "{it}");
    }
    let text = domain.run(&["doctor"]).stdout();
    assert!(text.starts_with("LEVEL  CHECK"), "{text}");
    assert!(text.contains("from --socket"), "{text}");
}

#[test]
fn what_is_wrong_is_told_with_a_cure() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("none.sock");
    let path = socket.to_str().unwrap();
    let run = || Running::start(&mut sm2(&["doctor", "--json", "--socket", path])).finish();
    let none = run();
    assert_eq!(none.code(), 1, "{none:?}");
    let found = report(&none);
    let manager = check(&found, "Manager");
    assert_eq!(manager["level"], "bad");
    let cure = format!("start one with `sm2 manager --socket {path}`");
    assert_eq!(manager["advice"], cure);

    // Files that dead Managers leave, and a folder that everybody may write to.
    fs::write(folder.path().join("none.sock.lock"), "").unwrap();
    fs::write(folder.path().join("none.sock~"), "").unwrap();
    fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o777)).unwrap();
    let found = report(&run());
    let left = found["checks"].as_array().unwrap().iter();
    let left: Vec<_> = left.filter(|it| it["check"] == "leftovers").collect();
    assert_eq!(left.len(), 2, "{found:#}");
    assert!(left.iter().all(|it| it["level"] == "warn"));
    assert_eq!(check(&found, "folder")["level"], "bad");
    assert!(
        check(&found, "folder")["advice"]
            .as_str()
            .unwrap()
            .contains("chmod o-w")
    );

    // A file in place of the socket.
    fs::write(&socket, "").unwrap();
    let found = report(&run());
    let left = found["checks"].as_array().unwrap().iter();
    assert!(
        left.clone()
            .any(|it| it["found"].as_str().unwrap().contains("is not a socket"))
    );
    let wrong = Running::start(&mut sm2(&["doctor", "--domain", "a/b"])).finish();
    wrong.failed(2, &["a/b"]);
}

#[test]
fn refusals_and_full_quotas_are_named() {
    let domain = Domain::with(&["--interfaces-per-session", "1"]);
    let node = domain.node("greedy");
    let _first = node.publisher::<str>("first").unwrap();
    assert!(node.publisher::<str>("second").is_err());
    let found = report(&domain.run(&["doctor", "--json"]));
    let quotas = check(&found, "quotas");
    assert_eq!(quotas["level"], "warn");
    assert_eq!(quotas["found"], "node greedy: 1 of 1 interfaces");
    let refused = check(&found, "refused interfaces");
    assert_eq!(refused["found"], "greedy:second");
    assert!(
        refused["advice"]
            .as_str()
            .unwrap()
            .contains("sm2 why greedy:second")
    );
}

#[test]
fn a_quota_of_which_four_fifths_are_used_is_named() {
    let domain = Domain::with(&["--interfaces-per-session", "5"]);
    let node = domain.node("busy");
    let publishers = ["a", "b", "c"].map(|it| node.publisher::<str>(it).unwrap());
    let found = report(&domain.run(&["doctor", "--json"]));
    assert_eq!(check(&found, "quotas")["level"], "ok", "{found:#}");
    let _fourth = node.publisher::<str>("d").unwrap();
    let found = report(&domain.run(&["doctor", "--json"]));
    let quotas = check(&found, "quotas");
    assert_eq!(quotas["level"], "warn");
    assert_eq!(quotas["found"], "node busy: 4 of 5 interfaces");
    let advice = "close some, or raise interfaces_per_session of `sm2 manager`";
    assert_eq!(quotas["advice"], advice);
    drop(publishers);
}

/// A subscriber that is linked with nobody is named if a publisher may be meant for it.
#[test]
fn subscribers_that_miss_their_publisher_are_named() {
    let domain = Domain::new();
    let (camera, detector) = (domain.node("camera"), domain.node("detector"));
    let unlinked = || {
        let found = report(&domain.run(&["doctor", "--json"]));
        check(&found, "unlinked subscribers").clone()
    };
    let image = camera.publisher::<[u8]>("camera/image").unwrap();
    // None of these is meant: another topic, another type, and a topic that has a subscriber.
    let _info = detector.subscriber::<[u8]>("camera/info").unwrap();
    let _text = detector.subscriber::<str>("camera/imag").unwrap();
    let viewer = detector.subscriber::<[u8]>("camera/image").unwrap();
    let _later = detector.subscriber::<[u8]>("camera/images").unwrap();
    assert_eq!(unlinked()["level"], "ok");

    drop(viewer);
    until("the misspelt topic is named", || {
        let found = unlinked();
        found["level"] == "warn"
            && found["found"]
                == "camera's publisher of camera/image and detector's subscriber of camera/images: \
                    their names differ (by one character only)"
            && found["advice"] == "see `sm2 why camera:camera/image detector:camera/images`"
    });
    let topic = detector.subscriber_builder::<[u8]>("camera/image");
    let _reliable = topic.reliable(true).declare().unwrap();
    until("the demand is named", || {
        let found = unlinked()["found"].as_str().unwrap().to_owned();
        found.contains("detector's subscriber of camera/image demands reliability, which camera's ")
    });
    drop(image);
    until("they may be the first of their topics", || {
        unlinked()["level"] == "ok"
    });
}

#[test]
fn a_stopped_node_is_seen() {
    let domain = Domain::new();
    let (listener, name) = listener(&domain, "scan", 1);
    let found = report(&domain.run(&["doctor", "--json"]));
    assert_eq!(check(&found, "stopped nodes")["level"], "ok", "{found:#}");
    listener.signal(Signal::SIGSTOP);
    let pid = listener.pid();
    until("the process is stopped", || {
        let found = report(&domain.run(&["doctor", "--json"]));
        let stopped = check(&found, "stopped nodes");
        let text = format!("node {name} (process {pid}) is stopped by a signal");
        let remedy = format!("continue it with `kill -CONT {pid}`");
        stopped["found"] == text && stopped["advice"] == remedy
    });
    listener.signal(Signal::SIGCONT);
}

#[test]
fn a_standby_is_seen() {
    let domain = Domain::new();
    let standby = domain.start(&["manager", "--standby"]);
    let expression = format!("node:sm2/standby/{}", standby.pid());
    let waited = domain.run(&["wait", &expression, "--timeout", "60s"]);
    assert_eq!(waited.code(), 0, "{waited:?} {}", standby.stderr());
    let found = report(&domain.run(&["doctor", "--json"]));
    let check = check(&found, "standby");
    assert_eq!(check["level"], "ok");
    assert_eq!(check["found"], format!("process {}", standby.pid()));
}
