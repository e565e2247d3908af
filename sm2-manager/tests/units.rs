//! The unit files of the Manager in `packaging/systemd`.

#[path = "../../packaging/systemd/check.rs"]
mod check;

use check::{SYSTEM, Units, is_hardened};

const MANAGER: Units = Units {
    program: "sm2-manager",
    path: env!("CARGO_BIN_EXE_sm2-manager"),
};

#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    MANAGER.are_accepted(SYSTEM);
    MANAGER.are_accepted(("user", "--user"));
}

#[test]
fn the_units_use_options_that_exist() {
    for unit in [
        "sm2-manager.service",
        "sm2-manager@.service",
        "user/sm2-manager.service",
    ] {
        MANAGER.options_exist(unit);
    }
}

#[test]
fn systemd_finds_the_managers_units_hardened() {
    for unit in ["sm2-manager.service", "sm2-manager@.service"] {
        is_hardened(unit, 4);
    }
}
