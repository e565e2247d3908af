//! Two hosts on this machine, with a bad link between them for all IP packets, including TCP.
//!
//! Hosts, cables, rate and loss are those of [`sm2_lossy_link`]. Its middle namespace becomes a
//! router here. Each routed packet passes a TUN device, which holds it for the delay of the link:
//!
//! ```text
//! near, tbf  ->  loss -> tun0 -> held -> tun0  ->  far
//! near       <-  tun0 <- held <- tun0 <- loss  <-  far, tbf
//! ```
//!
//! Requires root, `ip`, `tc`, `nft` and `/dev/net/tun`.

use std::{
    fs,
    io::{self, Write},
    path::PathBuf,
    process::{Command, Stdio},
};

use sm2_lossy_link::{LossyLink, Namespace, Profile, Unavailable};

use crate::job::Side;

use delay::Delay;

pub use address::address;

mod address;
mod delay;

/// The device that all packets pass.
const TUN: &str = "tun0";

/// The routing table of packets that have not passed the device yet.
const TABLE: u32 = 100;

/// The reason why a link cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The hosts cannot be made.
    #[error(transparent)]
    Hosts(#[from] Unavailable),
    /// The TUN device, which holds packets, cannot be made.
    #[error("cannot make a TUN device (`/dev/net/tun`): {0}")]
    Tun(io::Error),
    /// The routes between the hosts cannot be set.
    #[error("cannot route packets between network namespaces: {0}")]
    Route(io::Error),
}

/// A link, which exists until it is dropped. Processes at its hosts must end first.
#[derive(Debug)]
pub struct Link {
    hosts: LossyLink,
    // Dropping it ends its thread.
    _delay: Delay,
}

impl Link {
    /// Makes two hosts and a link of this profile between them.
    ///
    /// # Errors
    ///
    /// See [`LinkError`].
    pub fn new(profile: &Profile) -> Result<Self, LinkError> {
        let hosts = LossyLink::namespaces(profile.clone())?;
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

    /// The file of a host's network namespace, which exists as long as the link.
    #[must_use]
    pub fn network(&self, side: Side) -> PathBuf {
        let host = self.hosts.host(side.into());
        host.map(Namespace::path).unwrap_or_default()
    }
}

/// Checks that this machine can make a link.
///
/// # Errors
///
/// The reason why it cannot.
pub fn available() -> Result<(), String> {
    let made = Link::new(&Profile::wifi());
    made.map(drop).map_err(|error| error.to_string())
}

/// Routes packets between the hosts to the middle namespace, and there through the device.
fn route(hosts: &LossyLink, between: &Namespace) -> io::Result<()> {
    for (side, gateway) in [(Side::Near, "10.77.1.2"), (Side::Far, "10.77.2.2")] {
        let Some(host) = hosts.host(side.into()) else {
            continue;
        };
        host.enter(|| ip(&format!("route add default via {gateway}\n")))??;
    }
    between.enter(|| {
        // Packets from the device have source addresses of other interfaces, which reverse path
        // filtering would drop.
        for scope in ["all", "default", TUN] {
            fs::write(format!("/proc/sys/net/ipv4/conf/{scope}/rp_filter"), "0")?;
        }
        fs::write("/proc/sys/net/ipv4/ip_forward", "1")?;
        ip(&format!(
            "rule add iif near lookup {TABLE}\nrule add iif far lookup {TABLE}\n\
             route add default dev {TUN} table {TABLE}\n"
        ))
    })?
}

/// Runs `ip` in the network namespace of the calling thread.
fn ip(commands: &str) -> io::Result<()> {
    // Users' paths often lack the folders where `ip` is installed.
    let path = std::env::var("PATH").unwrap_or_else(|_| "/usr/bin:/bin".to_owned());
    let mut child = Command::new("ip")
        .args(["-batch", "-"])
        .env("PATH", path + ":/usr/sbin:/sbin")
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    if let Some(mut input) = child.stdin.take() {
        // If `ip` ends early, its standard error has the reason.
        let _ = input.write_all(commands.as_bytes());
    }
    let output = child.wait_with_output()?;
    match output.status.success() {
        true => Ok(()),
        false => {
            let stderr = String::from_utf8_lossy(&output.stderr);
            let reason = stderr.lines().next().unwrap_or("it gave no reason");
            Err(io::Error::other(format!("`ip`: {reason}")))
        }
    }
}

#[cfg(test)]
mod tests;
