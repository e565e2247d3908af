//! Discovery by beacons, over the sockets of the kernel: in a network namespace, since a beacon has a fixed port.

use std::{fs, process::Command};

use sm2_gateway::Gateway;
use sm2_lossy_link::Namespace;
use sm2_test_support::{skip, skip_without, until};

use crate::common::{ALL, Domain, report, runtime};

/// The interface of the network, and its other end.
const DEVICES: [&str; 2] = ["wired0", "wired1"];

/// A network with a pair of interfaces. Where that is not possible, the test is skipped.
fn network() -> Option<Namespace> {
    let network = Namespace::new()
        .inspect_err(|error| skip(format_args!("no network namespace: {error}")))
        .ok()?;
    let [one, other] = DEVICES;
    let commands = [
        // Carries what is sent to an address of the network itself.
        "link set lo up".to_owned(),
        format!("link add {one} type veth peer name {other}"),
        format!("link set {one} up"),
        format!("link set {other} up"),
    ];
    let done = network.enter(|| {
        // An address counts at once. Without this file the test takes a second longer.
        let _ = fs::write("/proc/sys/net/ipv6/conf/default/accept_dad", "0");
        for command in &commands {
            let ip = Command::new("ip").args(command.split(' ')).output();
            let ip = ip.map_err(|error| error.to_string())?;
            if !ip.status.success() {
                return Err(String::from_utf8_lossy(&ip.stderr).into_owned());
            }
        }
        Ok(())
    });
    done.unwrap()
        .inspect_err(|reason| skip_without("ip", reason))
        .ok()?;
    Some(network)
}

/// Neither gateway knows the address of the other. Both use the port of beacons at the same time.
//= SM2-GWD-005 test
#[test]
fn gateways_find_each_other_by_beacons() {
    let Some(network) = network() else { return };
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let start = |domain: &Domain, peer: &Domain| {
        let mut config = domain.config_at("[::]:0", &[(peer, None)], ALL);
        config.discovery = vec![DEVICES[0].to_owned()];
        let started = network.enter(|| runtime.block_on(Gateway::start(&config)));
        started.unwrap().unwrap()
    };
    let (left, right) = (start(&near, &far), start(&far, &near));
    for gateway in [&left, &right] {
        until("connected", || report(&runtime, gateway).peers.len() == 1);
    }
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

#[test]
fn an_interface_that_does_not_exist_is_named() {
    let Some(network) = network() else { return };
    let near = Domain::new("near");
    let runtime = runtime();
    let mut config = near.config(&[], ALL);
    config.discovery = [DEVICES[0], "nothing7"].map(str::to_owned).to_vec();
    let started = network.enter(|| runtime.block_on(Gateway::start(&config)));
    let error = started
        .unwrap()
        .expect_err("an interface that does not exist");
    assert!(error.to_string().contains("nothing7"), "{error}");
}
