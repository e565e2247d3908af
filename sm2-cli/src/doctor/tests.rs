use super::*;
use crate::{
    doctor::check::Level,
    doctor::machine::{files_within, version},
    doctor::socket::{is_locked, rule},
};

#[test]
fn kernel_releases_are_compared_by_their_numbers() {
    assert_eq!(version("6.1.0-13-amd64"), Some((6, 1)));
    assert_eq!(version("5.10"), Some((5, 10)));
    assert!(version("5.9.1") < version("5.11.0"));
    assert_eq!(version("unknown"), None);
}

#[test]
fn a_process_wants_files_for_links_with_every_node() {
    // 64, and four for each node.
    let enough = files_within(464, 464, Some(100));
    assert_eq!(enough.level, Level::Ok);
    assert_eq!(enough.found, "464 (at most 464)");
    let soft = files_within(463, 464, Some(100));
    assert_eq!(soft.level, Level::Warn);
    let advice = "a domain of this size wants 464: ulimit -n 464";
    assert_eq!(soft.advice.as_deref(), Some(advice));
    let hard = files_within(463, 463, Some(100));
    assert_eq!(hard.level, Level::Warn);
    let advice = "a domain of this size wants 464: raise it in limits.conf";
    assert_eq!(hard.advice.as_deref(), Some(advice));
    assert_eq!(files_within(64, 64, None).level, Level::Ok);
    assert_eq!(files_within(63, 64, None).level, Level::Warn);
}

#[test]
fn locks_are_found_by_inode() {
    let locks = "\
1: FLOCK  ADVISORY  WRITE 7622 fe:00:125671 0 EOF
2: -> FLOCK  ADVISORY  WRITE 7623 fe:00:99 0 EOF
3: POSIX  ADVISORY  WRITE 7540 fe:00:125655 0 EOF";
    assert!(is_locked(locks, 125_671));
    assert!(is_locked(locks, 125_655));
    // A process that waits for a lock does not hold it.
    assert!(!is_locked(locks, 99));
    assert!(!is_locked(locks, 671));
}

#[test]
fn the_rule_that_chose_the_socket_is_named() {
    let domain = |domain: Option<&str>, socket: Option<&str>| Domain {
        domain: domain.map(str::to_owned),
        socket: socket.map(Into::into),
        connect_timeout: std::time::Duration::ZERO,
        wait_manager: None,
    };
    let nothing = |_: &str| None;
    assert_eq!(rule(&domain(None, Some("/x")), nothing), "from --socket");
    let only = |wanted: &'static str, value: &'static str| {
        move |name: &str| (name == wanted).then(|| value.to_owned())
    };
    assert_eq!(
        rule(&domain(None, None), only("SM2_SOCKET", "/x")),
        "from $SM2_SOCKET"
    );
    assert_eq!(
        rule(
            &domain(Some("arm"), None),
            only("XDG_RUNTIME_DIR", "/run/user/1")
        ),
        "domain arm by --domain, in $XDG_RUNTIME_DIR"
    );
    assert_eq!(
        rule(&domain(None, None), only("SM2_DOMAIN", "leg")),
        "domain leg by $SM2_DOMAIN, in /run, since $XDG_RUNTIME_DIR is not set"
    );
    assert_eq!(
        rule(&domain(None, None), nothing),
        "domain default by the default, in /run, since $XDG_RUNTIME_DIR is not set"
    );
}
