//! Questions to all gateways of a domain.

use std::{fs, time::Duration};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_gateway::report;
use sm2_proto::Name;
use sm2_test_support::{SOON, until};

use crate::common::{ALL, Domain, Process};

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
