//! A gateway is killed and another one takes its place. Local nodes are not affected.

use sm2_test_support::until;

use crate::{
    common::{ALL, Domain, Process, runtime},
    traffic::{Listener, Talker, assert_complete, assert_newer},
};

/// True if the other one starts only when the domains have lost what is remote, which takes the 5 s after which a
/// silent connection ends.
const IS_MISSED: bool = cfg!(feature = "slow");

#[test]
fn a_gateway_that_is_killed_takes_only_what_is_remote_with_it() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    far.config(&[(&near, Some(left.address()))], ALL);
    let file = far.path("gateway.toml");
    let killed = Process::start(&file);
    let names = [
        (&near, "robot"),
        (&near, "beside"),
        (&far, "away"),
        (&far, "there"),
    ];
    let nodes = names.map(|(domain, name)| domain.node(name));
    let [robot, beside, away, there] = &nodes;
    // One topic in each direction, each with a local and a remote subscriber.
    let [pose, order] =
        [(robot, "pose"), (away, "order")].map(|(node, topic)| Talker::start(node, topic, 200, 50));
    let local = [
        Listener::all(beside, "pose", &pose),
        Listener::all(there, "order", &order),
    ];
    let remote = [
        Listener::newest(there, "pose", &pose),
        Listener::newest(beside, "order", &order),
    ];
    let heard = |all: &[Listener]| all.iter().map(Listener::count).collect::<Vec<_>>();
    until("all are heard", || {
        heard(&local)
            .iter()
            .chain(&heard(&remote))
            .all(|it| *it > 0)
    });
    let ids = nodes.each_ref().map(|it| (it.id(), it.epoch()));
    killed.kill();
    if IS_MISSED {
        until("what is remote leaves both domains", || {
            remote.iter().all(Listener::is_cut_off)
        });
    }
    let before = (heard(&local), heard(&remote));
    until("local nodes hear each other", || {
        heard(&local)
            .iter()
            .zip(&before.0)
            .all(|(now, then)| now > then)
    });
    if IS_MISSED {
        assert_eq!(heard(&remote), before.1);
    }
    let sent = [pose.count(), order.count()];
    let _another = Process::start(&file);
    until("what is remote is back", || {
        remote.iter().zip(sent).all(|(it, sent)| it.has_newer(sent))
    });
    until("one link each", || remote.iter().all(|it| it.links() == 1));
    if IS_MISSED {
        assert!(remote.iter().all(|it| it.ended() == 1));
    }
    assert!(local.iter().all(|it| it.links() == 1 && it.ended() == 0));
    assert_eq!(nodes.each_ref().map(|it| (it.id(), it.epoch())), ids);
    assert_undisturbed(local, remote, [pose.stop(), order.stop()]);
    runtime.block_on(left.stop());
}

/// Asserts that the local subscribers have all of this number of messages, and the remote ones none twice.
fn assert_undisturbed(local: [Listener; 2], remote: [Listener; 2], counts: [u64; 2]) {
    for ((listener, count), who) in local.into_iter().zip(counts).zip(["beside", "there"]) {
        let seen = listener.stop();
        let first = seen[0].number.expect("not damaged");
        assert_complete(who, &seen, count - first);
    }
    for listener in remote {
        assert_newer("remote", &listener.stop());
    }
}
