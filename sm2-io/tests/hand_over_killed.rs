//! Processes compete for one domain, hand it over, and are killed at arbitrary instructions. In its own file:
//! a child process holds copies of all descriptors until it calls `exec`.

use sm2_test_support::{SOON, ran_alone, seed};
use std::io::{BufRead, BufReader, Read};
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Instant;

use sm2_io::{BindOptions, DomainSocket, DomainSocketError, Listener, SeqPacket};

const PATH: &str = "SM2_IO_TEST_HAND_OVER";
const KILLS: usize = if cfg!(feature = "slow") { 200 } else { 30 };
/// Tells a contender the seed of its random choices.
const SEED: &str = "SM2_IO_TEST_HAND_OVER_SEED";

/// A child process that is killed when dropped.
struct Started(Child);

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(test: &str, path: &Path, stdin: Stdio, choices: u64) -> (Started, Receiver<String>) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            &format!("hand_over_killed::{test}"),
            "--ignored",
            "--nocapture",
        ])
        .env(PATH, path)
        .env(SEED, choices.to_string())
        .stdin(stdin)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let stdout = BufReader::new(child.stdout.take().unwrap());
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        let mut lines = stdout.lines().map_while(Result::ok);
        lines.all(|line| sender.send(line).is_ok())
    });
    (Started(child), lines)
}

/// Reads until a line ends with `end`. Returns `false` at the end of the output, or if there is no such line in time.
fn until(lines: &Receiver<String>, end: &str) -> bool {
    let late = Instant::now() + SOON;
    loop {
        let left = late.saturating_duration_since(Instant::now());
        match lines.recv_timeout(left) {
            Ok(line) if line.ends_with(end) => return true,
            Ok(_) => {}
            Err(_) => return false,
        }
    }
}

//= SM2-TRN-007 test
//= SM2-RES-009 test
#[test]
fn never_two_owners() {
    if ran_alone(concat!(module_path!(), "::never_two_owners")) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sm2/default.sock");
    std::fs::create_dir(path.parent().unwrap()).unwrap();
    let first = seed();
    let mut started = 0;
    let mut contend = || {
        started += 1;
        let choices = first.wrapping_add(started);
        start("a_contender", &path, Stdio::piped(), choices)
    };
    let mut contenders: Vec<_> = (0..3).map(|_| contend()).collect();
    for kill in 0..KILLS {
        let (_, lines) = &contenders[kill % 3];
        // The process continues meanwhile, so the kill hits it at an arbitrary instruction.
        assert!(until(lines, "owned"), "a contender failed: see above");
        contenders[kill % 3] = contend();
    }
    for (mut contender, _) in contenders {
        drop(contender.0.stdin.take());
        let mut status = None;
        sm2_test_support::until("the end of a contender", || {
            status = contender.0.try_wait().unwrap();
            status.is_some()
        });
        assert!(status.unwrap().success());
    }
    // Files that killed processes left do not prevent acquiring the path.
    let endpoint = BindOptions::acquire(&path).unwrap();
    assert!(SeqPacket::connect(&path).is_ok());
    drop(endpoint);
    let left = path.parent().unwrap().read_dir().unwrap();
    let left: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| name == "token"), "{left:?}");
}

#[test]
#[ignore = "runs in child processes of another test"]
fn a_contender() {
    let Some(path) = std::env::var_os(PATH).map(PathBuf::from) else {
        return;
    };
    let token = path.with_file_name("token");
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // Blocks until the parent closes the pipe.
            let _ = std::io::stdin().read(&mut [0]);
            stop.store(true, Ordering::Relaxed);
        });
        let seed = std::env::var(SEED).unwrap().parse::<u64>().unwrap() as u32;
        let (mut random, mut owned, late) = (seed, 0, Instant::now() + SOON);
        while !stop.load(Ordering::Relaxed) {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            match BindOptions::acquire(&path) {
                Ok(endpoint) => {
                    owned += 1;
                    // Prints only once: the parent may not read any more.
                    contend(endpoint, &token, random >> 30, &stop, owned == 1 + seed % 5);
                }
                Err(DomainSocketError::Busy { .. }) if owned > 0 || Instant::now() < late => {
                    std::thread::yield_now();
                }
                Err(error) => fail(&error.to_string()),
            }
        }
    });
}

fn contend(endpoint: DomainSocket, token: &Path, way: u32, stop: &AtomicBool, tell: bool) {
    own(token);
    if tell {
        println!("owned");
    }
    if way == 0 {
        return endpoint.close();
    }
    let hand_over = endpoint.hand_over();
    if way == 1 {
        return;
    }
    if way == 2 {
        // Waits until a successor has come.
        let late = Instant::now() + SOON;
        while !hand_over.is_replaced() && !stop.load(Ordering::Relaxed) {
            if Instant::now() > late {
                fail("nobody came");
            }
            std::thread::yield_now();
        }
        return;
    }
    if let Ok(endpoint) = hand_over.reclaim() {
        own(token);
        drop(endpoint);
    }
}

/// Owns the token for a moment. The token is created with its owner's process id in one step. Only a killed
/// process leaves its token; and the kernel releases the lock of such a process a little before the process
/// is gone.
fn own(token: &Path) {
    let me = std::process::id().to_string();
    let late = Instant::now() + SOON;
    while let Err(error) = symlink(&me, token) {
        if error.kind() != std::io::ErrorKind::AlreadyExists {
            fail(&format!("token: {error}"));
        }
        let Ok(other) = std::fs::read_link(token) else {
            fail("two owners: the other one has just ended");
        };
        if is_dead(&other) {
            std::fs::remove_file(token).unwrap();
        } else if Instant::now() > late {
            fail(&format!("two owners: {other:?} lives"));
        } else {
            std::thread::yield_now();
        }
    }
    std::thread::yield_now();
    match std::fs::read_link(token) {
        Ok(owner) if owner == Path::new(&me) => std::fs::remove_file(token).unwrap(),
        other => fail(&format!("two owners: the token says {other:?}")),
    }
}

/// Whether the process is gone, or is a zombie.
fn is_dead(process: &Path) -> bool {
    let Ok(stat) = std::fs::read_to_string(Path::new("/proc").join(process).join("stat")) else {
        return true;
    };
    // The state follows the name, which may contain any characters.
    let state = stat
        .rsplit(") ")
        .next()
        .and_then(|rest| rest.chars().next());
    matches!(state, Some('Z' | 'X'))
}

/// Exits the whole process, even while another thread waits for input.
fn fail(why: &str) -> ! {
    eprintln!("{why}");
    std::process::exit(1)
}

/// The credentials that clients see must name the process that adopted the socket: `--replace` sends its
/// signal there.
#[test]
fn who_takes_over_a_listening_socket_is_who_listens() {
    if ran_alone(concat!(
        module_path!(),
        "::who_takes_over_a_listening_socket_is_who_listens"
    )) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("default.sock");
    let socket: OwnedFd = Listener::bind(&path, 5).unwrap().into();
    let listens = || {
        let client = SeqPacket::connect(&path).unwrap();
        client.peer_credentials().unwrap().pid.cast_unsigned()
    };
    assert_eq!(listens(), std::process::id());
    let (child, lines) = start("an_activated_one", &path, socket.into(), 0);
    assert!(until(&lines, "adopted"));
    assert_eq!(listens(), child.0.id());
    assert!(matches!(
        BindOptions::acquire(&path),
        Err(DomainSocketError::Busy { .. })
    ));
}

#[test]
#[ignore = "runs in a child process of another test"]
fn an_activated_one() {
    if std::env::var_os(PATH).is_none() {
        return;
    }
    let socket = std::os::fd::AsFd::as_fd(&std::io::stdin()).try_clone_to_owned();
    let _endpoint = BindOptions::default().adopt(socket.unwrap()).unwrap();
    println!("adopted");
    loop {
        std::thread::park();
    }
}
