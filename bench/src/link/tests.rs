//! The link as processes at its hosts see it. Where there can be none, the reason is said.

use std::{
    fs,
    io::{Read, Write},
    net::{TcpListener, TcpStream, UdpSocket},
    thread,
    time::{Duration, Instant},
};

use sm2_lossy_link::{LossyLink, Profile};

use super::{Link, address};
use crate::job::Side;

fn link(profile: &Profile) -> Option<Link> {
    let refused = |reason: &super::LinkError| eprintln!("skipped, no link: {reason}");
    Link::new(profile).inspect_err(refused).ok()
}

impl Link {
    fn at<T: Send>(&self, side: Side, work: impl FnOnce() -> T + Send) -> T {
        self.hosts.enter(side.into(), work).unwrap()
    }

    /// Bytes and packets that came from the near host.
    fn carried(&self) -> (u64, u64) {
        let number = |name: &str| {
            let text = self.hosts.between().unwrap().enter(|| {
                // The names in /sys would be those of another network.
                fs::read_to_string("/proc/thread-self/net/dev").unwrap()
            });
            let text = text.unwrap();
            let line = text.lines().find_map(|it| it.trim().strip_prefix("near:"));
            let mut words = line.unwrap().split_whitespace();
            let at = usize::from(name == "packets");
            words.nth(at).unwrap().parse::<u64>().unwrap()
        };
        (number("bytes"), number("packets"))
    }
}

/// The link of the paper, without random loss and jitter.
fn lossless() -> Profile {
    Profile {
        loss_permille: 0,
        jitter: Duration::ZERO,
        pauses: Vec::new(),
        ..Profile::wifi()
    }
}

/// A socket at the far host that sends everything back.
fn echo(link: &Link) -> UdpSocket {
    let far = link.at(Side::Far, || UdpSocket::bind("0.0.0.0:5000").unwrap());
    let answering = far.try_clone().unwrap();
    thread::spawn(move || {
        let mut buffer = [0; 2_048];
        while let Ok((len, from)) = answering.recv_from(&mut buffer) {
            if len == 0 {
                break;
            }
            let _ = answering.send_to(&buffer[..len], from);
        }
    });
    far
}

fn near(link: &Link) -> UdpSocket {
    let near = link.at(Side::Near, || UdpSocket::bind("0.0.0.0:0").unwrap());
    near.connect((address(Side::Far), 5_000)).unwrap();
    near
}

#[test]
fn a_round_trip_takes_both_delays() {
    let profile = lossless();
    let Some(link) = link(&profile) else { return };
    let (_far, near) = (echo(&link), near(&link));
    let trips = (0..20).map(|number: u8| {
        let sent = Instant::now();
        near.send(&[number; 100]).unwrap();
        near.recv(&mut [0; 100]).unwrap();
        sent.elapsed()
    });
    let shortest = trips.min().unwrap();
    eprintln!("shortest round trip: {shortest:?}");
    assert!(shortest >= 2 * profile.delay);
    near.send(&[]).unwrap();
}

#[test]
fn each_way_loses_its_part() {
    let profile = Profile {
        loss_permille: 200,
        ..lossless()
    };
    let Some(link) = link(&profile) else { return };
    let (_far, near) = (echo(&link), near(&link));
    near.set_read_timeout(Some(Duration::from_millis(500)))
        .unwrap();
    let sending = near.try_clone().unwrap();
    let sender = thread::spawn(move || {
        for number in 0..2_000_u32 {
            sending.send(&number.to_le_bytes()).unwrap();
            thread::sleep(Duration::from_micros(200));
        }
    });
    let came = std::iter::from_fn(|| near.recv(&mut [0; 4]).ok()).count();
    sender.join().unwrap();
    eprintln!("{came} of 2,000 came back");
    // 64 of 100; six times the deviation apart.
    assert!((1_150..1_410).contains(&came), "{came}");
}

#[test]
fn tcp_crosses_it_in_single_frames_at_its_rate() {
    let profile = lossless();
    let Some(link) = link(&profile) else { return };
    let listener = link.at(Side::Far, || TcpListener::bind("0.0.0.0:5000").unwrap());
    let reader = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let (mut buffer, mut len) = (vec![0; 1 << 16], 0);
        while let Ok(more @ 1..) = stream.read(&mut buffer) {
            len += more;
        }
        (len, Instant::now())
    });
    let to = (address(Side::Far), 5_000);
    let mut stream = link.at(Side::Near, || TcpStream::connect(to).unwrap());
    let (before, start) = (link.carried(), Instant::now());
    stream.write_all(&vec![1; 4_000_000]).unwrap();
    drop(stream);
    let (len, end) = reader.join().unwrap();
    let after = link.carried();
    assert_eq!(len, 4_000_000);
    let seconds = (end - start).as_secs_f64();
    let frame = (after.0 - before.0) / (after.1 - before.1);
    let rate = len as f64 * 8.0 / seconds / 1e6;
    eprintln!("TCP: {rate:.1} Mbit/s, frames of {frame} bytes");
    assert!(rate * 1e6 < profile.rate_bit);
    assert!((1_000..=1_514).contains(&frame), "{frame}");
}

#[test]
fn hosts_without_routes_do_not_reach_each_other() {
    let Ok(hosts) = LossyLink::namespaces(lossless()) else {
        return;
    };
    let to = (address(Side::Far), 5_000);
    let connected = hosts.enter(Side::Near.into(), || TcpStream::connect(to));
    assert!(connected.unwrap().is_err());
}
