//! How much a peer gets of a topic beside peers whose links are slow, stuck or cut, and beside stopped peers.
//!
//! `cargo run --release -p sm2-gateway --example beside -- [SECONDS [BYTES]]`, as root, with `ip` and `tc`.
//! `BYTES` selects one length of messages.
//!
//! The gateway `hub` has a link of its own to each peer, in a network namespace: `good` without a limit, and eight
//! bad ones. Each gateway runs in a process of its own, with a domain. A node in the domain of `hub` publishes, and
//! a node in the domain of each peer subscribes. A part of the run begins with all links good. It counts the share
//! of the messages that arrive at `good`, first while `good` subscribes alone, then while the bad peers subscribe and
//! are bad. It prints the second share in percent of the first one.

mod gateways;
mod network;
mod process;

use std::{error::Error, thread, time::Duration};

use network::{Network, Quality};
use process::Peer;

/// The number of bad peers.
const BAD: usize = 8;
/// Time for a link to become busy, and for connections to come back.
const SETTLE: Duration = Duration::from_secs(2);
/// Lengths in bytes, and messages per second.
const STREAMS: [(usize, u32); 3] = [(1_000, 1_000), (100_000, 30), (1_000_000, 30)];
const DEPTHS: [u16; 3] = [1, 16, 1_024];

type Done<T = ()> = Result<T, Box<dyn Error>>;

/// How the bad peers are bad.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// 50 kbit/s.
    Slow,
    /// 1 Mbit/s.
    Narrow,
    /// The network interface keeps all packets.
    Stuck,
    /// The cable is cut.
    Cut,
    /// The process of the peer is stopped.
    Stopped,
}

const FAULTS: [Fault; 5] = [
    Fault::Slow,
    Fault::Narrow,
    Fault::Stuck,
    Fault::Cut,
    Fault::Stopped,
];

fn main() -> Done {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["gateway", folder, number] => gateways::serve(folder.as_ref(), number.parse()?),
        [] => compare(Duration::from_secs(8), None),
        [seconds] => compare(Duration::from_secs(seconds.parse()?), None),
        [seconds, bytes] => compare(Duration::from_secs(seconds.parse()?), Some(bytes.parse()?)),
        _ => Err(
            "the arguments are the length of a part in seconds, and a length of messages".into(),
        ),
    }
}

/// Prints one line for each stream and depth.
fn compare(part: Duration, only: Option<usize>) -> Done {
    let folder = tempfile::tempdir()?;
    let network = Network::new(1 + BAD)?;
    gateways::configure(folder.path(), 1 + BAD)?;
    let mut peers = Vec::new();
    for number in 1..=1 + BAD {
        peers.push(Peer::start(folder.path(), number, network.host(number))?);
    }
    let mut hub = Peer::start(folder.path(), 0, network.host(0))?;
    let (good, bad) = peers.split_first_mut().ok_or("no peers")?;
    println!("what a good peer gets beside bad ones, in percent of what it gets alone");
    print!("{:>9} {:>5} {:>6}", "bytes", "Hz", "depth");
    for count in [1, BAD] {
        for fault in FAULTS {
            print!(" {:>9}", format!("{count} {fault:?}").to_lowercase());
        }
    }
    println!(" {:>9}", "8 mixed");
    let is_selected = |it: &(usize, u32)| only.is_none_or(|only| it.0 == only);
    for (len_bytes, hz) in STREAMS.into_iter().filter(is_selected) {
        for depth in DEPTHS {
            print!("{len_bytes:>9} {hz:>5} {depth:>6}");
            hub.say(&format!("publish {len_bytes} {hz}"))?;
            good.say(&format!("subscribe {depth}"))?;
            good.until_linked()?;
            thread::sleep(SETTLE);
            for count in [1, BAD] {
                for fault in FAULTS {
                    let share =
                        beside(&network, &mut hub, good, &mut bad[..count], part, |_| fault);
                    print!(" {:>9.1}", share?);
                }
            }
            let mixed = |at: usize| FAULTS[at % FAULTS.len()];
            let share = beside(&network, &mut hub, good, bad, part, mixed)?;
            println!(" {share:>9.1}");
            good.say("unsubscribe")?;
            hub.say("stop")?;
        }
    }
    Ok(())
}

/// The share while these peers are bad, in percent of the share without them.
fn beside(
    network: &Network,
    hub: &mut Peer,
    good: &mut Peer,
    bad: &mut [Peer],
    part: Duration,
    fault: impl Fn(usize) -> Fault,
) -> Done<f64> {
    let alone = share(hub, good, part)?;
    let depth = good.depth();
    for peer in bad.iter_mut() {
        peer.say(&format!("subscribe {depth}"))?;
        peer.until_linked()?;
    }
    thread::sleep(SETTLE);
    for (at, peer) in bad.iter().enumerate() {
        match fault(at) {
            Fault::Slow => network.set(2 + at, Quality::Rate("50kbit"))?,
            Fault::Narrow => network.set(2 + at, Quality::Rate("1mbit"))?,
            Fault::Stuck => network.set(2 + at, Quality::Rate("8bit"))?,
            Fault::Cut => network.set(2 + at, Quality::Cut)?,
            Fault::Stopped => peer.stop()?,
        }
    }
    let beside = share(hub, good, part)?;
    for (at, peer) in bad.iter_mut().enumerate() {
        network.set(2 + at, Quality::Good)?;
        peer.go_on()?;
        peer.say("unsubscribe")?;
    }
    for peer in bad {
        peer.until_connected()?;
    }
    Ok(beside * 100.0 / alone)
}

/// The share of the messages that arrive in this time.
fn share(hub: &mut Peer, good: &mut Peer, part: Duration) -> Done<f64> {
    let counts = |hub: &mut Peer, good: &mut Peer| -> Done<_> { Ok((hub.count()?, good.count()?)) };
    let before = counts(hub, good)?;
    thread::sleep(part);
    let after = counts(hub, good)?;
    Ok((after.1 - before.1) as f64 / (after.0 - before.0) as f64)
}
