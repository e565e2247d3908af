//! A shutdown ends every wait of a node, with and without its background thread, on both lanes.

use std::io::{BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::thread;
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use sm2_io::is_signal_ignored;

use crate::common::fixture::Fixture;
use crate::common::threads::{until_asleep, while_asleep};
use crate::common::wait::LONG;
use crate::common::{Domain, SOON, WAYS, away, meet, next, until};
use sm2_node::domain::QueryError;
use sm2_node::{
    CallError, ConnectError, DeclareError, MissedTicks, Node, PublishError, Rate, RecvError,
    Shutdown, Wait, WaitError, now,
};

/// Requests the shutdown while a thread is asleep in `waits`.
fn ends<T: Send>(it: &Fixture, waits: impl FnOnce() -> T + Send) -> T {
    while_asleep(waits, |_| it.shutdown.request())
}

#[test]
fn it_ends_recv() {
    Fixture::each(|it| {
        let node = it.ending_node("listener");
        let subscriber = node.subscriber::<str>("topic").unwrap();
        let ended = ends(it, || subscriber.recv().map(drop));
        assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        let ended = subscriber.recv_timeout(LONG).map(drop);
        assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        let ended = subscriber.recv_each(1, |_| ());
        assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
    });
}

#[test]
fn it_ends_recv_in_a_thread_that_spins() {
    for way in WAYS {
        let domain = Domain::new();
        let shutdown = Shutdown::new().unwrap();
        let builder = domain.builder("listener");
        let node = builder.shutdown(&shutdown).connect().unwrap();
        let subscriber = node.subscriber_builder::<str>("topic").wait(way);
        let subscriber = subscriber.declare().unwrap();
        let publisher = domain.node("talker").publisher::<str>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| subscriber.recv().map(drop));
            shutdown.request();
            let ended = waiting.join().unwrap();
            assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        });
    }
}

/// Otherwise a program that always finds a message would not end.
#[test]
fn recv_ends_although_messages_are_there_and_try_recv_takes_them() {
    Fixture::each(|it| {
        let subscriber = it
            .ending_node("listener")
            .subscriber::<[u8]>("topic")
            .unwrap();
        let publisher = it.ending_node("talker").publisher::<[u8]>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish(&[1]).unwrap();
        publisher.publish(&[2]).unwrap();
        assert_eq!(&*next(&subscriber), &[1]);
        it.shutdown.request();
        let ended = subscriber.recv_timeout(SOON).map(drop);
        assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
        let left = subscriber.try_recv().unwrap().expect("a message");
        assert_eq!(&*left, &[2]);
        assert!(subscriber.try_recv().unwrap().is_none());
        // A last message of the program goes out.
        assert_eq!(publisher.publish(&[3]).unwrap().links, 1);
    });
}

#[test]
fn it_ends_a_reliable_publication_that_waits_for_room() {
    Fixture::each(|it| {
        let builder = it.ending_node("talker").publisher_builder::<[u8]>("topic");
        let publisher = builder.reliable(true).publish_timeout(LONG);
        let publisher = publisher.declare().unwrap();
        let builder = it.builder("listener").connect().unwrap();
        let builder = builder.subscriber_builder::<[u8]>("topic").reliable(true);
        let subscriber = builder.depth(1).max_borrowed(1).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let published = ends(it, || {
            let mut count = 0;
            loop {
                match publisher.publish(&[1]) {
                    Ok(_) => count += 1,
                    Err(error) => return (count, error),
                }
            }
        });
        let (count, error) = published;
        assert!(matches!(error, PublishError::Shutdown), "{error:?}");
        let mut taken = 0;
        until(|| {
            // Drives the publisher's node if it has no thread.
            publisher.links();
            taken += usize::from(subscriber.try_recv().unwrap().is_some());
            taken == count
        });
        assert!(subscriber.try_recv().unwrap().is_none());
    });
}

#[test]
fn it_ends_a_call_and_cancels_it() {
    Fixture::each(|it| {
        let server = it.builder("server").connect().unwrap();
        let server = server.server::<str, str>("service").unwrap();
        let client = it
            .ending_node("client")
            .client::<str, str>("service")
            .unwrap();
        let mut request = None;
        let ended = while_asleep(
            || client.call("hello").map(drop),
            |task| {
                request = server.recv_timeout(SOON).unwrap();
                until_asleep(task);
                it.shutdown.request();
            },
        );
        assert!(
            matches!(ended, Err(CallError::Shutdown { .. })),
            "{ended:?}"
        );
        let request = request.expect("a request");
        until(|| request.is_cancelled());
    });
}

#[test]
fn it_ends_waits_for_links() {
    Fixture::each(|it| {
        let publisher = it.ending_node("talker").publisher::<str>("topic").unwrap();
        let ended = ends(it, || publisher.wait_for_subscribers(1));
        assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
        publisher.flush().unwrap();
    });
}

#[test]
fn it_ends_waits_for_the_manager() {
    for background in [true, false] {
        let mut domain = Domain::new();
        let shutdown = Shutdown::new().unwrap();
        let builder = domain.builder("talker");
        let builder = builder.background(background).manager_timeout(LONG);
        let node = builder.shutdown(&shutdown).connect().unwrap();
        domain.stop();
        away(&[&node]);
        let ended = while_asleep(|| node.wait_connected(), |_| shutdown.request());
        assert!(matches!(ended, Err(WaitError::Shutdown)), "{ended:?}");
        let declared = node.publisher::<str>("topic").map(drop).unwrap_err();
        assert!(
            matches!(declared, DeclareError::Shutdown { .. }),
            "{declared:?}"
        );
        let asked = node.snapshot().map(drop).unwrap_err();
        assert!(matches!(asked, QueryError::Shutdown), "{asked:?}");
    }
}

/// A Manager that accepts connections and does not answer.
#[test]
fn it_ends_the_wait_of_a_node_that_connects() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("mute.sock");
    let _mute = sm2_io::Listener::bind(&socket, 8).unwrap();
    let shutdown = Shutdown::new().unwrap();
    let builder = Node::builder("talker").socket(&socket).shutdown(&shutdown);
    let builder = builder.manager_timeout(LONG);
    let ended = while_asleep(|| builder.connect().map(drop), |_| shutdown.request());
    assert!(matches!(ended, Err(ConnectError::Shutdown)), "{ended:?}");
}

#[test]
fn spinning_ends_without_an_error() {
    Fixture::each(|it| {
        let node = it.ending_node("talker");
        ends(it, || node.spin()).unwrap();
        node.spin_for(LONG).unwrap();
        node.spin_once().unwrap();
    });
}

/// The only unsafe part is the promise that the handler is async-signal-safe.
#[test]
fn a_signal_handler_ends_a_wait() {
    let domain = Domain::new();
    let shutdown = Shutdown::new().unwrap();
    let on_signal = shutdown.clone();
    // SAFETY: the handler only requests the shutdown, which is async-signal-safe.
    let id = unsafe {
        signal_hook::low_level::register(signal_hook::consts::SIGUSR1, move || on_signal.request())
    };
    let builder = domain.builder("listener");
    let node = builder.shutdown(&shutdown).connect().unwrap();
    let subscriber = node.subscriber_builder::<str>("topic").wait(Wait::Park);
    let subscriber = subscriber.declare().unwrap();
    let ended = while_asleep(
        || subscriber.recv().map(drop),
        |_| nix::sys::signal::raise(nix::sys::signal::Signal::SIGUSR1).unwrap(),
    );
    assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
    signal_hook::low_level::unregister(id.unwrap());
}

/// A child that waits for a message until a signal ends the wait, and is then stuck. Says both.
fn wait_and_be_stuck(socket: PathBuf) -> ! {
    let shutdown = Shutdown::on_signals().unwrap();
    let node = Node::builder("listener").socket(socket);
    let node = node.shutdown(&shutdown).connect().unwrap();
    let subscriber = node.subscriber::<str>("topic").unwrap();
    println!("waiting");
    let ended = subscriber.recv_timeout(SOON).map(drop);
    assert!(matches!(ended, Err(RecvError::Shutdown)), "{ended:?}");
    println!("stuck");
    thread::sleep(SOON);
    panic!("no signal has ended this program");
}

/// A child that does not outlive the test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
    }
}

/// The first signal ends the waits, and one more ends a program that is stuck.
#[test]
fn signals_end_the_waits_and_then_the_program() {
    const DOMAIN: &str = "SM2_TEST_DOMAIN_OF_SIGNALS";
    const TEST: &str = "shutdown::signals_end_the_waits_and_then_the_program";
    if let Some(socket) = std::env::var_os(DOMAIN) {
        wait_and_be_stuck(socket.into());
    }
    let domain = Domain::new();
    let signals = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP];
    for signal in signals
        .into_iter()
        .filter(|it| !is_signal_ignored(*it as i32))
    {
        let (says, output) = UnixStream::pair().unwrap();
        says.set_read_timeout(Some(SOON)).unwrap();
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", TEST, "--nocapture", "--test-threads=1"]);
        command
            .env(DOMAIN, domain.socket())
            .stdout(OwnedFd::from(output));
        let mut child = Killed(command.spawn().unwrap());
        drop(command);
        let number = Pid::from_raw(child.0.id().try_into().unwrap());
        let mut lines = BufReader::new(says).lines();
        for line in ["waiting", "stuck"] {
            assert!(
                lines.any(|it| it.unwrap().ends_with(line)),
                "{signal}: {line}"
            );
            kill(number, signal).unwrap();
        }
        let mut status = None;
        until(|| {
            status = child.0.try_wait().unwrap();
            status.is_some()
        });
        assert_eq!(status.unwrap().signal(), Some(signal as i32));
    }
}

#[test]
fn a_handle_can_be_used_by_several_threads() {
    fn is_shared<T: Send + Sync + Clone + 'static>() {}
    is_shared::<Shutdown>();
}

#[test]
fn it_ends_the_sleep_of_a_rate() {
    let shutdown = Shutdown::new().unwrap();
    let mut rate = Rate::every(LONG);
    let tick = while_asleep(|| rate.sleep_unless(&shutdown), |_| shutdown.request());
    assert_eq!(tick, None);
    // Also the next one, although its tick is due.
    let mut rate = Rate::every(Duration::from_nanos(1));
    assert_eq!(rate.sleep_unless(&shutdown), None);
}

#[test]
fn a_rate_sleeps_until_each_tick() {
    let shutdown = Shutdown::new().unwrap();
    let mut rate = Rate::every(Duration::from_millis(1)).missed_ticks(MissedTicks::Burst);
    for number in 1..=4 {
        let tick = match number % 2 {
            0 => rate.sleep(),
            _ => rate.sleep_unless(&shutdown).unwrap(),
        };
        assert_eq!((tick.number, tick.missed), (number, 0));
        assert!(tick.due <= now());
    }
}
