//! Two searches that share only the model have the same counts.

use sm2_model_viewer::{Counted, Watchable, count};
use sm2_verification::model::{
    domain::Scope,
    explore,
    link::{Fault, LinkScope},
};

fn counts_agree(name: &str, scope: &(impl Watchable + Clone)) {
    let theirs = count(scope.clone());
    let ours = Counted::from(explore(scope, usize::MAX));
    assert_eq!(theirs, ours, "{name}");
    assert!(ours.held && ours.states > 100, "{name}: {ours:?}");
}

#[test]
fn counts_of_domains_agree() {
    for name in ["cold-2x2", "takeovers-2x2"] {
        counts_agree(name, &Scope::named(name).expect("a scope"));
    }
}

#[test]
fn counts_of_links_agree() {
    for name in ["link-reliable-1", "link-full", "link-calls-full"] {
        counts_agree(name, &LinkScope::named(name).expect("a scope"));
    }
}

#[test]
fn what_is_broken_is_seen() {
    let mut scope = LinkScope::named("link-keep-last-1").expect("a scope");
    scope.fault = Some(Fault::ReleaseTwice);
    assert!(!count(scope).held);
}
