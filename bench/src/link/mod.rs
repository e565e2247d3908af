//! Two hosts of this machine and a bad link between them, over which every IP packet goes, TCP's too.
//!
//! Hosts, cables, rate and loss are those of [`sm2_lossy_link`]. Here its middle becomes a router,
//! and each packet that it routes passes a TUN device, where it is held for as long as the link takes:
//!
//! ```text
//! near, tbf  ->  loss -> tun0 -> held -> tun0  ->  far
//! near       <-  tun0 <- held <- tun0 <- loss  <-  far, tbf
//! ```
//!
//! What it takes: root, `ip`, `tc`, `nft` and `/dev/net/tun`.

use std::{
    fs,
    io::{self, Write},
    path::PathBuf,
    process::{Command, Stdio},
};

use sm2_lossy_link::{BadLink, Namespace, Profile, Unavailable};

use crate::job::Side;

use delay::Delay;

pub use address::address;

mod address;
mod delay;

/// The device through which all packets go.
const TUN: &str = "tun0";

/// The routing table of packets that were not held yet.
const TABLE: u32 = 100;

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// There are no hosts.
    #[error(transparent)]
    Hosts(#[from] Unavailable),
    /// Packets cannot be held.
    #[error("cannot make a TUN device (`/dev/net/tun`): {0}")]
    Tun(io::Error),
    /// Packets do not find their way.
    #[error("cannot route packets between network namespaces: {0}")]
    Route(io::Error),
}

/// A link, until it is dropped: processes at its hosts are to end before it.
#[derive(Debug)]
pub struct Link {
    hosts: BadLink,
    // Its thread ends with it.
    _delay: Delay,
}

impl Link {
    /// Two hosts that reach each other over a link like this.
    ///
    /// # Errors
    ///
    /// See [`LinkError`].
    pub fn new(profile: &Profile) -> Result<Self, LinkError> {
        let hosts = BadLink::namespaces(profile.clone())?;
        let between = hosts.between().ok_or(Unavailable::NotRoot)?;
        let device = between.enter(|| delay::device(TUN));
        let device = device.and_then(|made| made).map_err(LinkError::Tun)?;
        route(&hosts, between).map_err(LinkError::Route)?;
        let delay = Delay::start(device, profile).map_err(LinkError::Tun)?;
        Ok(Self {
            hosts,
            _delay: delay,
        })
    }

    /// Where the network of a host is found by processes of this machine, as long as the link is there.
    #[must_use]
    pub fn network(&self, side: Side) -> PathBuf {
        let host = self.hosts.host(side.into());
        host.map(Namespace::path).unwrap_or_default()
    }
}

/// Whether there can be a link here.
///
/// # Errors
///
/// Why not.
pub fn available() -> Result<(), String> {
    let made = Link::new(&Profile::wifi());
    made.map(drop).map_err(|error| error.to_string())
}

/// Sends what hosts have for each other to the middle, and what comes there through the device.
fn route(hosts: &BadLink, between: &Namespace) -> io::Result<()> {
    for (side, gateway) in [(Side::Near, "10.77.1.2"), (Side::Far, "10.77.2.2")] {
        let Some(host) = hosts.host(side.into()) else {
            continue;
        };
        host.enter(|| ip(&format!("route add default via {gateway}\n")))??;
    }
    between.enter(|| {
        // A packet from the device has the address of a host that is elsewhere.
        for place in ["all", "default", TUN] {
            fs::write(format!("/proc/sys/net/ipv4/conf/{place}/rp_filter"), "0")?;
        }
        fs::write("/proc/sys/net/ipv4/ip_forward", "1")?;
        ip(&format!(
            "rule add iif near lookup {TABLE}\nrule add iif far lookup {TABLE}\n\
             route add default dev {TUN} table {TABLE}\n"
        ))
    })?
}

/// Runs `ip` where the thread is.
fn ip(commands: &str) -> io::Result<()> {
    // Where it is, whatever the caller's path.
    let path = std::env::var("PATH").unwrap_or_else(|_| "/usr/bin:/bin".to_owned());
    let mut child = Command::new("ip")
        .args(["-batch", "-"])
        .env("PATH", path + ":/usr/sbin:/sbin")
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    if let Some(mut input) = child.stdin.take() {
        // One that does not read says why.
        let _ = input.write_all(commands.as_bytes());
    }
    let output = child.wait_with_output()?;
    match output.status.success() {
        true => Ok(()),
        false => {
            let said = String::from_utf8_lossy(&output.stderr);
            let reason = said.lines().next().unwrap_or("it did not say why");
            Err(io::Error::other(format!("`ip`: {reason}")))
        }
    }
}

#[cfg(test)]
mod tests;
