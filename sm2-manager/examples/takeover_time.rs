//! Measures how long a domain is without a Manager when the Manager is killed (SIGKILL) and a standby takes
//! over: the time from the kill until a node receives WELCOME.
//!
//! ```sh
//! cargo run --release -p sm2-manager --example takeover_time [rounds]
//! ```
//!
//! The node of this program tries again every 50 µs. A node of the library waits up to 10 ms before its first
//! attempt (SM2-RES-001), so that the nodes of a domain do not all connect at once.

use std::{
    env,
    error::Error,
    io::{BufRead, BufReader, IoSlice},
    os::fd::AsFd,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use sm2_io::{SeqPacket, wait_readable};
use sm2_manager::{Options, Standby};
use sm2_proto::control::{ToManager, encode_to_manager};

const ATTEMPT: Duration = Duration::from_micros(50);
const TIMEOUT: Duration = Duration::from_secs(30);

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let first = arguments.next();
    if first.as_deref() == Some("stand-by") {
        let path = arguments.next().ok_or("stand-by needs a path")?;
        return stand_by(Path::new(&path));
    }
    let rounds: usize = first.map_or(Ok(100), |rounds| rounds.parse())?;
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("domain.sock");
    let mut active = start(&path)?;
    let mut times = Vec::with_capacity(rounds);
    for _ in 0..rounds {
        let mut standby = start(&path)?;
        active.kill()?;
        let killed = Instant::now();
        while !is_welcomed(&path)? {
            if killed.elapsed() > TIMEOUT {
                standby.kill()?;
                return Err("nobody took over".into());
            }
            thread::sleep(ATTEMPT);
        }
        times.push(killed.elapsed());
        active.wait()?;
        active = standby;
    }
    active.kill()?;
    active.wait()?;
    times.sort_unstable();
    if let (Some(p50), Some(max)) = (times.get(rounds / 2), times.last()) {
        println!("from SIGKILL to WELCOME: p50 {p50:.1?}, max {max:.1?}, n {rounds}");
    }
    Ok(())
}

/// Starts another process of this program. When this returns, that process serves or stands by.
fn start(path: &Path) -> Result<Child, Box<dyn Error>> {
    let mut command = Command::new(env::current_exe()?);
    command.arg("stand-by").arg(path).stdout(Stdio::piped());
    let mut child = command.spawn()?;
    let stdout = child.stdout.take().ok_or("no output")?;
    let mut line = String::new();
    BufReader::new(stdout).read_line(&mut line)?;
    Ok(child)
}

fn stand_by(path: &Path) -> Result<(), Box<dyn Error>> {
    let mut standby = Standby::start(path, Options::default())?;
    println!("{:?}", standby.role());
    standby.run(|_| {})?;
    Ok(())
}

/// One connection attempt of a node. Returns whether it was welcomed.
fn is_welcomed(path: &Path) -> Result<bool, Box<dyn Error>> {
    let Ok(socket) = SeqPacket::connect(path) else {
        return Ok(false);
    };
    let hello = encode_to_manager(&ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: "node".parse()?,
        resuming: false,
    });
    if socket.send(&[IoSlice::new(&hello)], &[]).is_err() {
        return Ok(false);
    }
    wait_readable(&[socket.as_fd()], Some(TIMEOUT))?;
    // Anything but the end of the stream is WELCOME.
    Ok(socket.recv(&mut [0; 256]).is_ok())
}
