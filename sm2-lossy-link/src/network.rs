//! Three namespaces in a row: `ip` connects them, `tc` limits the rate, and `nft` loses packets.
//!
//! ```text
//! near                     link                       far
//! link0  10.77.1.1  <->  near  10.77.1.2
//!                        far   10.77.2.1  <->  10.77.2.2  link0
//! ```
//!
//! The IPv6 addresses are `fd77:1::` and `fd77:2::` with the same last digits. Each host sends at the
//! link's rate (`tbf`). In `link`, packets are lost at random before a socket or a route receives them.
//! `link` does not forward packets; a relay there passes datagrams on, unless the caller adds routes.

use std::{
    fmt::Write as _,
    io::{self, Write as _},
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    process::{Command, Stdio},
};

use crate::{
    namespace::Namespace,
    profile::{Profile, Side},
};

/// The interface of each host; [`host_address`] returns its addresses.
pub const DEVICE: &str = "link0";

/// The reason why namespaces cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unavailable {
    /// The process is not root.
    #[error("network namespaces need root")]
    NotRoot,
    /// A program is not installed.
    #[error("`{0}` is not installed (packages iproute2 and nftables)")]
    Missing(&'static str),
    /// A program failed, for example in a container without rights, or without a module of the kernel.
    #[error("`{program}` failed: {reason}")]
    Failed {
        /// The name of the program.
        program: &'static str,
        /// The first line of its standard error.
        reason: String,
    },
    /// A system call failed.
    #[error("cannot make a network namespace: {0}")]
    System(io::Error),
}

/// The three namespaces.
#[derive(Debug)]
pub(crate) struct Network {
    pub(crate) near: Namespace,
    pub(crate) link: Namespace,
    pub(crate) far: Namespace,
}

impl Network {
    pub(crate) fn new(profile: &Profile) -> Result<Self, Unavailable> {
        if !nix::unistd::geteuid().is_root() {
            return Err(Unavailable::NotRoot);
        }
        let network = Self {
            near: Namespace::new().map_err(Unavailable::System)?,
            link: Namespace::new().map_err(Unavailable::System)?,
            far: Namespace::new().map_err(Unavailable::System)?,
        };
        tell(&network.link, "ip", &["-batch", "-"], "link set lo up\n")?;
        for side in [Side::Near, Side::Far] {
            network.wire(side)?;
            let limit = format!(
                "qdisc add dev {DEVICE} root tbf rate {:.0}bit burst {BURST_BYTES} latency {}us\n",
                profile.rate_bit,
                profile.queue.as_micros()
            );
            tell(network.host(side), "tc", &["-batch", "-"], &limit)?;
        }
        network.lose(profile.loss_permille, false)?;
        Ok(network)
    }

    pub(crate) const fn host(&self, side: Side) -> &Namespace {
        match side {
            Side::Near => &self.near,
            Side::Far => &self.far,
        }
    }

    /// Connects a host to the link with a pair of interfaces.
    fn wire(&self, side: Side) -> Result<(), Unavailable> {
        let (host, name) = (self.host(side), name(side));
        let link = self.link.path();
        let add = format!(
            "link set lo up\nlink add {DEVICE} type veth peer name {name} netns {}\n",
            link.display()
        );
        tell(host, "ip", &["-batch", "-"], &add)?;
        tell(host, "ip", &["-batch", "-"], &up(DEVICE, side, HOST))?;
        tell(&self.link, "ip", &["-batch", "-"], &up(name, side, LINK))?;
        Ok(())
    }

    /// Sets the random loss; if the link is cut, all packets are lost.
    pub(crate) fn lose(&self, loss_permille: u32, is_cut: bool) -> Result<(), Unavailable> {
        let rules = match (is_cut, loss_permille) {
            // ARP and the discovery of neighbours are not lost datagrams.
            (true, _) => vec![
                "meta l4proto udp counter drop".to_owned(),
                "drop".to_owned(),
            ],
            (false, 0) => vec!["accept".to_owned()],
            (false, loss) => {
                // nft refuses a comparison that is always true.
                let random = match loss {
                    1_000.. => String::new(),
                    loss => format!("numgen random mod 1000 < {loss} "),
                };
                vec![format!(
                    "meta l4proto {{ tcp, udp, icmp }} {random}counter drop"
                )]
            }
        };
        let from = "iifname { \"near\", \"far\" }";
        let rules: String = rules.iter().map(|it| format!("{from} {it}\n")).collect();
        // One transaction, so that a rule is in force at all times.
        let rules = format!(
            "table inet bad_link\ndelete table inet bad_link\ntable inet bad_link {{\n\
             chain arriving {{\ntype filter hook prerouting priority 0; policy accept;\n\
             {rules}}}\n}}\n"
        );
        tell(&self.link, "nft", &["-f", "-"], &rules)?;
        Ok(())
    }

    /// The number of packets that were lost since the loss was set. Without loss, nothing is counted.
    pub(crate) fn lost(&self) -> Result<u64, Unavailable> {
        let list = ["list", "chain", "inet", "bad_link", "arriving"];
        let listed = tell(&self.link, "nft", &list, "")?;
        let mut words = listed.split_whitespace();
        let counted = words.by_ref().find(|it| *it == "packets");
        let count = counted.and_then(|_| words.next()?.parse().ok());
        Ok(count.unwrap_or(0))
    }
}

/// The burst of the rate limit: two Ethernet frames.
const BURST_BYTES: u32 = 3_028;
/// The last digit of the addresses of a pair's two ends.
const HOST: u8 = 1;
const LINK: u8 = 2;

/// The address that a host has at first, in its own namespace.
#[must_use]
pub fn host_address(side: Side, is_ipv6: bool) -> IpAddr {
    address(side, is_ipv6, HOST)
}

/// The address of the link. A host sends datagrams for the other one there.
pub(crate) fn link_address(side: Side, is_ipv6: bool) -> IpAddr {
    address(side, is_ipv6, LINK)
}

/// Replaces an unspecified IP address by the address of the host.
pub(crate) fn from_outside(address: SocketAddr, side: Side) -> SocketAddr {
    match address.ip() {
        ip if ip.is_unspecified() => {
            SocketAddr::new(host_address(side, ip.is_ipv6()), address.port())
        }
        _ => address,
    }
}

fn address(side: Side, is_ipv6: bool, end: u8) -> IpAddr {
    let cable = match side {
        Side::Near => 1,
        Side::Far => 2,
    };
    match is_ipv6 {
        true => Ipv6Addr::new(0xfd77, cable.into(), 0, 0, 0, 0, 0, end.into()).into(),
        false => Ipv4Addr::new(10, 77, cable, end).into(),
    }
}

const fn name(side: Side) -> &'static str {
    match side {
        Side::Near => "near",
        Side::Far => "far",
    }
}

/// The commands that set the addresses of an interface. Segmentation offload is off, so that each
/// datagram is lost independently.
fn up(device: &str, side: Side, end: u8) -> String {
    let mut text = String::new();
    for (is_ipv6, more) in [(false, "/24"), (true, "/64")] {
        let nodad = if is_ipv6 { " nodad" } else { "" };
        let address = address(side, is_ipv6, end);
        let _ = writeln!(text, "addr add {address}{more} dev {device}{nodad}");
    }
    let _ = writeln!(text, "link set dev {device} gso_max_segs 1 up");
    text
}

/// Runs a program in a namespace, with `text` as its standard input. Returns its standard output.
fn tell(
    namespace: &Namespace,
    program: &'static str,
    arguments: &[&str],
    text: &str,
) -> Result<String, Unavailable> {
    let run = || {
        // Users' paths often lack the folders where these programs are installed.
        let path = std::env::var("PATH").unwrap_or_else(|_| "/usr/bin:/bin".to_owned());
        let path = path + ":/usr/sbin:/sbin";
        let mut child = Command::new(program)
            .args(arguments)
            .env("PATH", path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        if let Some(mut input) = child.stdin.take() {
            // If the program ends early, its standard error has the reason.
            let _ = input.write_all(text.as_bytes());
        }
        child.wait_with_output()
    };
    match namespace.enter(run).map_err(Unavailable::System)? {
        Ok(output) if output.status.success() => {
            Ok(String::from_utf8_lossy(&output.stdout).into_owned())
        }
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            let reason = said.lines().next().unwrap_or("it gave no reason");
            let reason = reason.to_owned();
            Err(Unavailable::Failed { program, reason })
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(Unavailable::Missing(program)),
        Err(error) => Err(Unavailable::System(error)),
    }
}

#[cfg(test)]
mod tests {
    use sm2_test_support::skip;

    use super::*;

    #[test]
    fn only_an_unspecified_address_is_replaced_by_that_of_the_host() {
        for (from, side, expected) in [
            ("0.0.0.0:5", Side::Near, "10.77.1.1:5"),
            ("0.0.0.0:5", Side::Far, "10.77.2.1:5"),
            ("[::]:5", Side::Near, "[fd77:1::1]:5"),
            ("[::]:5", Side::Far, "[fd77:2::1]:5"),
            ("10.77.2.9:5", Side::Far, "10.77.2.9:5"),
            ("[fd77:2::9]:5", Side::Far, "[fd77:2::9]:5"),
        ] {
            let outside = from_outside(from.parse().unwrap(), side);
            assert_eq!(outside, expected.parse().unwrap(), "{from} {side:?}");
        }
    }

    #[test]
    fn a_program_that_fails_or_is_missing_is_named() {
        let namespace = match Namespace::new() {
            Ok(namespace) => namespace,
            Err(error) => return skip(format_args!("no namespaces: {error}")),
        };
        let output = tell(&namespace, "cat", &[], "text").unwrap();
        assert_eq!(output, "text");
        let script = "echo why >&2; echo more >&2; exit 1";
        match tell(&namespace, "sh", &["-c", script], "").unwrap_err() {
            Unavailable::Failed { program, reason } => {
                assert_eq!((program, &*reason), ("sh", "why"));
            }
            other => panic!("{other}"),
        }
        let missing = tell(&namespace, "sm2-no-such-program", &[], "");
        let program = "sm2-no-such-program";
        assert!(matches!(missing, Err(Unavailable::Missing(it)) if it == program));
        // A file that is not a program.
        let other = tell(&namespace, "/etc/passwd", &[], "");
        assert!(matches!(other, Err(Unavailable::System(_))), "{other:?}");
    }
}
