//! Questions to all gateways of a domain.

use std::{fs, time::Duration};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_gateway::report;
use sm2_proto::Name;
use sm2_test_support::{SOON, until};

use crate::common::{ALL, Domain, Process, report as whole_report, runtime};

/// The time for all answers; half of it is for the links. In the slow form one attempt has to be enough. The other one
/// cannot fail on a busy machine, but a gateway whose question is sent too late may answer one attempt in many.
const TIMEOUT: Duration = match cfg!(feature = "slow") {
    true => SOON.saturating_mul(2),
    false => Duration::from_secs(2),
};

/// A gateway that does not open the link for the question gives no answer. The others do, whatever their names are.
#[test]
fn a_stuck_gateway_does_not_hide_another_one() {
    let domain = Domain::new("first");
    let first = domain.config(&[], ALL).path;
    let text = fs::read_to_string(&first).unwrap();
    let second = domain.path("second.toml");
    fs::write(&second, text.replace("\"first\"", "\"second\"")).unwrap();
    let gateways = [first, second].map(|it| Process::listening(&it).0);
    let services =
        ["gateway/first/status", "gateway/second/status"].map(|it| Name::new(it).unwrap());
    let node = domain.node("tool");
    until("two gateways", || {
        report::gateways(&node.snapshot().unwrap())
            .into_iter()
            .eq(services.clone())
    });
    for (stuck, gateway) in gateways.iter().enumerate() {
        let signal = |it| kill(Pid::from_raw(gateway.id().cast_signed()), it).unwrap();
        signal(Signal::SIGSTOP);
        until("the answer of the other gateway", || {
            let answers = report::ask(&node, services.clone().into(), TIMEOUT);
            assert!(answers.iter().map(|(it, _)| it).eq(&services));
            assert!(answers[stuck].1.is_err());
            answers[1 - stuck].1.is_ok()
        });
        signal(Signal::SIGCONT);
    }
}

/// The comparison with a shadow follows the offers of the peers.
#[test]
fn a_shadow_is_compared_again_when_a_peer_offers_something() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    // These rules let nothing pass.
    left.set_shadow(near.config(&[(&far, None)], ""));
    let changes = || whole_report(&runtime, &left).shadow.map(|it| it.len());
    until("connected", || {
        !whole_report(&runtime, &left).peers.is_empty()
    });
    until("a comparison", || changes() == Some(0));
    let node = far.node("talker");
    let publisher = node.publisher::<u64>("chatter").unwrap();
    until("a change", || changes() == Some(1));
    drop(publisher);
    until("none again", || changes() == Some(0));
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}
