//! The unit file of the gateway in `packaging/systemd`, and the rights that the program gives up by itself.

#[path = "../../packaging/systemd/check.rs"]
mod check;

use crate::common::{Domain, Process};
use check::{SYSTEM, Units, is_hardened};
use sm2_test_support::until;

const GATEWAY: Units = Units {
    program: "sm2-gateway",
    path: env!("CARGO_BIN_EXE_sm2-gateway"),
};

#[test]
fn systemd_finds_nothing_wrong_with_the_unit() {
    GATEWAY.are_accepted(SYSTEM);
}

#[test]
fn the_unit_uses_options_that_exist() {
    GATEWAY.options_exist("sm2-gateway@.service");
}

/// A gateway needs the host's network, so its exposure is greater than that of a Manager.
#[test]
fn systemd_finds_the_gateways_unit_hardened() {
    is_hardened("sm2-gateway@.service", 13);
}

#[test]
fn a_gateway_gives_up_new_rights() {
    let domain = Domain::new("robot");
    // Writes the configuration.
    let config = domain.config(&[], "");
    let gateway = Process::start(&config.path);
    until("no new rights", || gateway.status("NoNewPrivs:") == "1");
}
