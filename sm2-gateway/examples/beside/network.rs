//! One host in the middle, with a cable of its own to each of the others.

use std::{
    io::{self, Write},
    process::{Command, Stdio},
};

use sm2_lossy_link::Namespace;

use crate::Done;

/// The packets that a link carries to a peer.
pub(crate) enum Quality {
    /// All packets.
    Good,
    /// At most this rate.
    Rate(&'static str),
    /// No packets.
    Cut,
}

/// The rate of a good link, and the bytes that its queue holds, like the 1,000 packets of a Wi-Fi interface.
const GOOD: &str = "10gbit";
const QUEUE: &str = "burst 1mb limit 1500000";

/// The hosts: number 0 is in the middle.
pub(crate) struct Network(Vec<Namespace>);

impl Network {
    pub(crate) fn new(peers: usize) -> Done<Self> {
        let hosts: Result<_, _> = (0..=peers).map(|_| Namespace::new()).collect();
        let network = Self(hosts?);
        network.run(0, "ip", "link set lo up\n")?;
        for number in 1..=peers {
            let path = network.host(number).path();
            let path = path.display();
            network.run(
                0,
                "ip",
                &format!(
                    "link add p{number} type veth peer name link0 netns {path}\n\
                 addr add 10.78.{number}.1/24 dev p{number}\nlink set p{number} up\n"
                ),
            )?;
            network.run(
                number,
                "ip",
                &format!(
                    "link set lo up\naddr add 10.78.{number}.2/24 dev link0\nlink set link0 up\n"
                ),
            )?;
            network.run(
                0,
                "tc",
                &format!("qdisc add dev p{number} root tbf rate {GOOD} {QUEUE}\n"),
            )?;
        }
        Ok(network)
    }

    pub(crate) fn host(&self, number: usize) -> &Namespace {
        &self.0[number]
    }

    pub(crate) fn set(&self, peer: usize, quality: Quality) -> Done {
        let (cable, rate) = match quality {
            Quality::Good => ("up", GOOD),
            Quality::Rate(rate) => ("up", rate),
            Quality::Cut => ("down", GOOD),
        };
        self.run(peer, "ip", &format!("link set link0 {cable}\n"))?;
        // A qdisc that is replaced would drop what it holds.
        self.run(
            0,
            "tc",
            &format!("qdisc change dev p{peer} root tbf rate {rate} {QUEUE}\n"),
        )
    }

    fn run(&self, host: usize, program: &str, commands: &str) -> Done {
        let run = || -> io::Result<_> {
            let mut child = Command::new(program)
                .args(["-batch", "-"])
                .stdin(Stdio::piped())
                .spawn()?;
            if let Some(mut input) = child.stdin.take() {
                input.write_all(commands.as_bytes())?;
            }
            child.wait()
        };
        match self.0[host].enter(run)??.success() {
            true => Ok(()),
            false => Err(format!("{program}: {commands}").into()),
        }
    }
}

/// The address of the hub for a peer.
pub(crate) fn hub_address(peer: usize) -> String {
    format!("10.78.{peer}.1:7633")
}
