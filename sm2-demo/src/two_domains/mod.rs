//! `sm2 demo --bad-link`: shows that a lossy link between two domains does not slow down the domain of the
//! publisher.
//!
//! Each domain has a Manager and a gateway. The link between the gateways carries an eighth of the published
//! bytes, loses some datagrams and pauses at times (the paper's Fig. 2). One subscriber is in the publisher's
//! domain; the other one joins in the far domain after a third of the time.

mod report;
mod traffic;

use std::{
    io::{self, Write},
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    os::fd::BorrowedFd,
    path::Path,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use sm2_gateway::{Config, Gateway, keys};
use sm2_io::clock;
use sm2_lossy_link::{LossyLink, Profile, Side as End};
use sm2_manager::Background;
use sm2_node::Node;
use sm2_proto::Instant;
use tokio::runtime::Runtime;

use self::{
    report::{Report, Window},
    traffic::{Log, Seen, Shared, lock},
};
use crate::{
    error::DemoError,
    folder,
    options::{Ending, Format, Options},
    output::{size_text, write_json},
    waiting::pause,
};

/// The depth of the local subscriber; the remote one takes only the newest message.
const LOCAL_DEPTH: u16 = 4;
/// The time after a change that is left out of the figures.
const SETTLING: Duration = Duration::from_secs(1);
/// Timeout for the connection of the gateways, which a busy machine delays.
const CONNECTING: Duration = Duration::from_secs(60);
/// Timeout for the first message to the far domain after the time of the demo.
const TIMEOUT: Duration = Duration::from_secs(10);

/// One of the two domains.
struct Side {
    _manager: Background,
    node: Node,
    gateway: Gateway,
}

/// Runs the demo in `out`. It ends early when `stop` becomes readable, and then reports what it has.
///
/// # Errors
///
/// See [`DemoError`].
pub fn run(
    options: &Options,
    out: &mut dyn Write,
    stop: BorrowedFd<'_>,
) -> Result<Ending, DemoError> {
    options.check_memory()?;
    let folder = folder::private()?;
    let runtime = Runtime::new().map_err(DemoError::system("start threads"))?;
    for name in ["near", "far"] {
        keys::generate(&folder.path().join(format!("{name}.key")))
            .map_err(|error| DemoError::Gateway(error.to_string()))?;
    }
    let (mut link, no_namespaces) = LossyLink::open(Profile::wifi());
    if let Some(reason) = &no_namespaces {
        try_loopback().map_err(|source| DemoError::Loopback {
            no_namespaces: reason.to_string(),
            source,
        })?;
    }
    let far = Side::start(&runtime, folder.path(), &link, End::Far, None)?;
    let way = link.connect(far.gateway.address());
    let way = way.map_err(DemoError::system("make a link"))?;
    let near = Side::start(&runtime, folder.path(), &link, End::Near, Some(way))?;
    wait_for_peers(&runtime, &near)?;
    if options.format != Format::Json {
        announce(out, options, &link)?;
        if let Some(reason) = no_namespaces {
            writeln!(out, "the link is a relay inside this process: {reason}")?;
        }
        writeln!(
            out,
            "  s   local Hz  p99 us   remote Hz   Mbit/s  age p50 ms"
        )?;
        out.flush()?;
    }
    let report = measure(options, &link, &near, &far, stop, out)?;
    drop(link);
    runtime.block_on(async { tokio::join!(near.gateway.stop(), far.gateway.stop()) });
    match options.format {
        Format::Json => write_json(out, &report)?,
        Format::Terminal | Format::Lines => write_summary(out, &report)?,
    }
    Ok(report.ending())
}

/// Sends a datagram to this process itself, as the relay does. A new network namespace has a loopback
/// interface that is down.
fn try_loopback() -> io::Result<()> {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    socket.send_to(b"lo", socket.local_addr()?).map(drop)
}

/// Announces the run in one line.
fn announce(out: &mut dyn Write, options: &Options, link: &LossyLink) -> Result<(), DemoError> {
    let profile = link.profile();
    let pauses = profile.pauses.iter().map(|it| {
        let (length, every) = (it.length.as_millis(), it.every.as_secs());
        format!("{length} ms about every {every} s")
    });
    writeln!(
        out,
        "{} at {} Hz in one domain, for {} s; to another domain over a link ({}) of {} Mbit/s that loses {} % and \
         pauses for {}",
        size_text(options.size_bytes),
        options.rate_hz,
        options.seconds,
        link.kind().as_str(),
        profile.rate_bit / 1e6,
        f64::from(profile.loss_permille) / 10.0,
        pauses.collect::<Vec<_>>().join(" and ")
    )?;
    Ok(())
}

/// Waits until the gateways are connected.
fn wait_for_peers(runtime: &Runtime, side: &Side) -> Result<(), DemoError> {
    let connected = async {
        let gateway = &side.gateway;
        while gateway.report().await.is_some_and(|it| it.peers.is_empty()) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    runtime
        .block_on(async { tokio::time::timeout(CONNECTING, connected).await })
        .map_err(|_| DemoError::Gateway("the gateways did not find each other".to_owned()))
}

impl Side {
    fn start(
        runtime: &Runtime,
        folder: &Path,
        link: &LossyLink,
        end: End,
        peer_address: Option<SocketAddr>,
    ) -> Result<Self, DemoError> {
        let (name, peer) = match end {
            End::Near => ("near", "far"),
            End::Far => ("far", "near"),
        };
        let failed = |error: String| DemoError::Gateway(error);
        let socket = folder.join(format!("{name}.sock"));
        let manager = Background::start(&socket, sm2_manager::Options::default())
            .map_err(DemoError::Manager)?;
        let node = Node::builder(&format!("{name}-demo"))
            .socket(&socket)
            .connect()
            .map_err(DemoError::node)?;
        let id = keys::load(&folder.join(format!("{peer}.key")));
        let id = id.map_err(|error| failed(error.to_string()))?.id();
        let addresses = peer_address.map_or_else(String::new, |it| format!("\"{it}\""));
        let text = format!(
            "name = \"{name}\"\nlisten = \"{}\"\nkey = \"{name}.key\"\n\
             socket = \"{name}.sock\"\n\
             [[peer]]\nname = \"{peer}\"\nid = \"{id}\"\naddresses = [{addresses}]\n\
             [[rule]]\naction = \"allow\"\nnames = \"**\"\n",
            link.listen()
        );
        let config = Config::parse(&folder.join("gateway.toml"), &text);
        let config = config.map_err(|error| failed(error.to_string()))?;
        // The gateway's socket belongs to the network of the host that makes it.
        let gateway = link.enter(end, || runtime.block_on(Gateway::start(&config)));
        let gateway = gateway.map_err(DemoError::system("enter a network namespace"))?;
        Ok(Self {
            _manager: manager,
            node,
            gateway: gateway.map_err(|error| failed(error.to_string()))?,
        })
    }
}

/// Publishes and receives, and shows the figures of each second.
fn measure(
    options: &Options,
    link: &LossyLink,
    near: &Side,
    far: &Side,
    stop: BorrowedFd<'_>,
    out: &mut dyn Write,
) -> Result<Report, DemoError> {
    let size_bytes = usize::try_from(options.size_bytes).unwrap_or(usize::MAX);
    let shared = Arc::new(Shared::default());
    let (local, listening) = traffic::subscribe(&near.node, Arc::clone(&shared), LOCAL_DEPTH)?;
    let period = options.period();
    let talking = traffic::publish(near.node.clone(), Arc::clone(&shared), size_bytes, period)?;
    let begin = clock::now();
    let length = Duration::from_secs_f64(options.seconds);
    let join_at = begin.after(length / 3);
    let mut remote = None;
    let mut stopped = false;
    for second in 1.. {
        let from = begin.after(Duration::from_secs(second - 1));
        let until = begin.after(Duration::from_secs(second));
        let until = match from < begin.after(length) {
            true => until.min(begin.after(length)),
            false => until,
        };
        if remote.is_none() && join_at < until {
            // If it ends by `stop`, so does the pause below.
            pause(&near.node, stop, join_at)?;
            remote = Some(traffic::subscribe(&far.node, Arc::clone(&shared), 1)?);
        }
        stopped |= pause(&near.node, stop, until)?;
        if options.format != Format::Json {
            let window = Window { from, to: until };
            let away = remote.as_ref().map(|(log, _)| log);
            show(
                out,
                second,
                &window,
                options.size_bytes,
                [Some(&local), away],
            )?;
        }
        let away = remote.as_ref().map(|(log, _)| log);
        if stopped || is_over(clock::now(), begin.after(length), join_at, &seen(away)) {
            break;
        }
    }
    let end = clock::now();
    shared.stop.store(true, Ordering::Relaxed);
    let (log, away) = remote.unzip();
    for thread in [Some(talking), Some(listening), away].into_iter().flatten() {
        thread
            .join()
            .map_err(|_| DemoError::Gateway("a part of the demo panicked".to_owned()))??;
    }
    let before = Window {
        from: begin.after(SETTLING),
        to: join_at.min(end),
    };
    let after = Window {
        from: join_at.after(SETTLING),
        to: end,
    };
    let [local, away] = [Some(&local), log.as_ref()].map(seen);
    Ok(Report {
        interrupted: stopped,
        ..Report::new(options.size_bytes, link, [before, after], &local, &away)
    })
}

/// Whether the time of the demo is over, and a message has come to the far domain. On a busy machine, the demo goes on
/// until one has.
fn is_over(now: Instant, end: Instant, join_at: Instant, away: &[Seen]) -> bool {
    let (from, to) = (join_at.after(SETTLING), now);
    now >= end.after(TIMEOUT) || now >= end && Window { from, to }.hz(away) > 0.0
}

/// Writes a line of the table.
fn show(
    out: &mut dyn Write,
    second: u64,
    window: &Window,
    size_bytes: u64,
    logs: [Option<&Log>; 2],
) -> Result<(), DemoError> {
    let [local, away] = logs.map(seen);
    writeln!(
        out,
        "{second:3} {:10.1} {:7.0} {:11.2} {:8.1} {:11.1}",
        window.hz(&local),
        window.age(&local, 99) / 1e3,
        window.hz(&away),
        window.hz(&away) * 8e-6 * size_bytes as f64,
        window.age(&away, 50) / 1e6,
    )?;
    Ok(out.flush()?)
}

/// The messages that a subscriber has received so far; none if it has not joined.
fn seen(log: Option<&Log>) -> Vec<Seen> {
    log.map_or_else(Vec::new, |log| lock(log).clone())
}

fn write_summary(out: &mut dyn Write, report: &Report) -> Result<(), DemoError> {
    let Report { local, remote, .. } = report;
    writeln!(
        out,
        "local:  {} Hz before, {} Hz after; p99 {} us before, {} us after; {} lost, {} damaged",
        local.hz_before,
        local.hz_after,
        local.p99_us_before,
        local.p99_us_after,
        local.lost,
        local.damaged
    )?;
    writeln!(
        out,
        "remote: {} Hz, {} Mbit/s in whole messages; age p50 {} ms, p99 {} ms; {} damaged",
        remote.hz, remote.goodput_mbit, remote.age_ms.p50, remote.age_ms.p99, remote.damaged
    )?;
    Ok(out.flush()?)
}

#[cfg(test)]
mod tests;
