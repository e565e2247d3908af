//! `probe --write PATH`: reports how this process is confined, in one line: `ok` for each operation
//! that is possible, else the system's error.

use std::{
    fs::{self, File},
    process::ExitCode,
};

use nix::{
    errno::Errno,
    sys::socket::{AddressFamily, SockFlag, SockType, socket},
    unistd::geteuid,
};
use sm2_tests::options::Options;

pub(crate) fn run(options: &Options) -> ExitCode {
    let make = |family| {
        let made = socket(family, SockType::Datagram, SockFlag::empty(), None);
        word(made.map(drop))
    };
    let path: String = options.get("--write").expect("--write");
    let written = File::create(path).map(drop);
    let written = written.map_err(|error| Errno::from_raw(error.raw_os_error().unwrap_or(0)));
    // The header has two lines.
    let devices = fs::read_to_string("/proc/self/net/dev").unwrap_or_default();
    println!(
        "unix={} inet={} inet6={} netlink={} write={} devices={} uid={}",
        make(AddressFamily::Unix),
        make(AddressFamily::Inet),
        make(AddressFamily::Inet6),
        make(AddressFamily::Netlink),
        word(written),
        devices.lines().count().saturating_sub(2),
        geteuid()
    );
    ExitCode::SUCCESS
}

fn word(result: Result<(), Errno>) -> String {
    result.map_or_else(|error| format!("{error:?}"), |()| "ok".to_owned())
}
