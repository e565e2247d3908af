//! Compares two ways to wake several receivers that sleep in `epoll_wait`.
//!
//! `cargo run --release -p sm2-io --example wake_many`
//!
//! - *one by one*: a datagram of 64 bytes to the socket of each receiver, as DOORBELL (SM2-RNG-012);
//! - *together*: one write to an eventfd that is in the epoll set of each receiver, edge-triggered, so that nobody has
//!   to read it.
//!
//! For each number of receivers, prints the processor time of the sender for one round, and the time until all
//! receivers are awake: medians of 2,000 rounds, which alternate. Receivers are threads.

use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::eventfd::{EfdFlags, EventFd};
use nix::time::{ClockId, clock_gettime};
use sm2_io::SeqPacket;

const ROUNDS: usize = 2_000;
const RECEIVERS: [usize; 4] = [1, 2, 5, 16];
/// Long enough for all receivers to sleep again.
const PAUSE: Duration = Duration::from_micros(300);

type Done<T = ()> = Result<T, Box<dyn Error + Send + Sync>>;

/// The times of one round, in nanoseconds.
struct Round {
    sender: u64,
    all_awake: u64,
}

fn main() -> Done {
    println!("            sender, us of CPU          all awake, us");
    println!("receivers   one by one   together   one by one   together");
    for receivers in RECEIVERS {
        let [one_by_one, together] = compare(receivers)?;
        println!(
            "{receivers:>9} {:>12.2} {:>10.2} {:>12.1} {:>10.1}",
            one_by_one.sender as f64 / 1e3,
            together.sender as f64 / 1e3,
            one_by_one.all_awake as f64 / 1e3,
            together.all_awake as f64 / 1e3,
        );
    }
    Ok(())
}

/// The medians for the two ways.
fn compare(receivers: usize) -> Done<[Round; 2]> {
    let bell = EventFd::from_value_and_flags(0, EfdFlags::EFD_NONBLOCK)?;
    let awake = AtomicUsize::new(0);
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for _ in 0..receivers {
        let (one, other) = SeqPacket::pair()?;
        ours.push(one);
        theirs.push(other);
    }
    thread::scope(|scope| {
        let (bell, awake) = (&bell, &awake);
        let threads: Vec<_> = theirs
            .iter()
            .map(|socket| scope.spawn(move || receive(socket, bell, awake)))
            .collect();
        let mut rounds = [Vec::new(), Vec::new()];
        for _ in 0..ROUNDS {
            let one_by_one = || -> Done {
                for socket in &ours {
                    socket.send(&[std::io::IoSlice::new(&[1; 64])], &[])?;
                }
                Ok(())
            };
            rounds[0].push(round(receivers, awake, one_by_one)?);
            let together = || -> Done {
                bell.write(1)?;
                Ok(())
            };
            rounds[1].push(round(receivers, awake, together)?);
        }
        // The end of its socket ends a receiver.
        ours.clear();
        for thread in threads {
            thread.join().map_err(|_| "a receiver panicked")??;
        }
        Ok(rounds.map(|rounds| Round {
            sender: median(rounds.iter().map(|it| it.sender)),
            all_awake: median(rounds.iter().map(|it| it.all_awake)),
        }))
    })
}

fn round(receivers: usize, awake: &AtomicUsize, wake: impl FnOnce() -> Done) -> Done<Round> {
    thread::sleep(PAUSE);
    awake.store(0, Ordering::SeqCst);
    let (start, before) = (Instant::now(), processor_time()?);
    wake()?;
    let sender = (processor_time()? - before).as_nanos() as u64;
    while awake.load(Ordering::SeqCst) < receivers {
        thread::yield_now();
    }
    let all_awake = start.elapsed().as_nanos() as u64;
    Ok(Round { sender, all_awake })
}

/// Counts each time that it wakes up, until its socket ends.
fn receive(socket: &SeqPacket, bell: &EventFd, awake: &AtomicUsize) -> Done {
    const SOCKET: u64 = 0;
    let set = Epoll::new(EpollCreateFlags::empty())?;
    set.add(socket, EpollEvent::new(EpollFlags::EPOLLIN, SOCKET))?;
    let edges = EpollFlags::EPOLLIN | EpollFlags::EPOLLET;
    set.add(bell, EpollEvent::new(edges, 1))?;
    let mut events = [EpollEvent::empty(); 2];
    let mut buffer = [0; 64];
    loop {
        let count = set.wait(&mut events, EpollTimeout::NONE)?;
        for event in &events[..count] {
            if event.data() == SOCKET && socket.recv(&mut buffer).is_err() {
                return Ok(());
            }
            awake.fetch_add(1, Ordering::SeqCst);
        }
    }
}

fn processor_time() -> nix::Result<Duration> {
    Ok(clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)?.into())
}

fn median(values: impl Iterator<Item = u64>) -> u64 {
    let mut values: Vec<u64> = values.collect();
    values.sort_unstable();
    values[values.len() / 2]
}
