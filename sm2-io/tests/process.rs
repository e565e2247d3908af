//! The process at the other end of a connection.

use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use nix::libc;
use nix::sys::signal::{Signal, kill};
use nix::sys::wait::{WaitStatus, waitpid};
use nix::unistd::{ForkResult, Pid, fork, getpid};
use sm2_io::fault::{Call, Fault, Injector};
use sm2_io::{Listener, PeerProcess, RecvError, SeqPacket, is_signal_ignored, wait_readable};
use sm2_test_support::{SOON, ran_alone};

/// The first way to the process fails, `SO_PEERPIDFD`, or the second one, `pidfd_open(2)`.
fn failing(nth: u64, errno: i32) -> Fault {
    Fault {
        call: Call::PidfdOpen,
        nth,
        times: 1,
        errno,
    }
}

fn running(socket: &SeqPacket) -> sm2_io::ProcessFd {
    match PeerProcess::of(socket).unwrap() {
        PeerProcess::Running(process) => process,
        other => panic!("{other:?}"),
    }
}

/// A process that connects to `path`, makes a child, and says the number of the child. The child has the connection
/// until the other end of `line` is closed.
fn connect_and_fork(path: &std::path::Path, mut line: UnixStream) -> ! {
    let _socket = SeqPacket::connect(path).unwrap();
    // SAFETY: both processes use system calls only, and end.
    match unsafe { fork() }.unwrap() {
        ForkResult::Child => {
            let _ = line.write_all(&getpid().as_raw().to_ne_bytes());
            let _ = line.read(&mut [0]);
        }
        ForkResult::Parent { .. } => loop {
            std::thread::park();
        },
    }
    // SAFETY: ends this process without running anything else of the test program.
    unsafe { libc::_exit(0) }
}

/// The end of a process shows, although its child keeps the connection open: by the socket, and by its number.
#[test]
fn the_end_of_the_process_that_connected_is_told() {
    if ran_alone(concat!(
        module_path!(),
        "::the_end_of_the_process_that_connected_is_told"
    )) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("socket");
    let listener = Listener::bind(&path, 16).unwrap();
    let (mut hold, line) = UnixStream::pair().unwrap();
    // SAFETY: the child uses system calls only, and ends by a signal.
    let parent = match unsafe { fork() }.unwrap() {
        ForkResult::Child => {
            drop(hold);
            connect_and_fork(&path, line)
        }
        ForkResult::Parent { child } => child,
    };
    drop(line);
    let mut number = [0; 4];
    hold.read_exact(&mut number).unwrap();
    let socket = listener.accept().unwrap().unwrap();
    let by_socket = running(&socket);
    let installed = Injector::new(failing(1, libc::ENOPROTOOPT)).install();
    let by_number = running(&socket);
    drop(installed);
    for process in [&by_socket, &by_number] {
        assert!(!wait_readable(&[process.as_fd()], Some(Duration::ZERO)).unwrap());
    }
    kill(parent, Signal::SIGKILL).unwrap();
    for process in [&by_socket, &by_number] {
        assert!(wait_readable(&[process.as_fd()], Some(SOON)).unwrap());
    }
    // The child has the connection.
    assert!(matches!(
        socket.recv(&mut [0; 8]),
        Err(sm2_io::RecvError::WouldBlock)
    ));
    kill(Pid::from_raw(i32::from_ne_bytes(number)), None).unwrap();
    waitpid(parent, None).unwrap();
    let _installed = Injector::new(failing(1, libc::ENOPROTOOPT)).install();
    assert!(matches!(
        PeerProcess::of(&socket).unwrap(),
        PeerProcess::Ended
    ));
}

#[test]
fn a_kernel_that_does_not_tell_is_no_error_and_a_shortage_is() {
    let (socket, _other) = SeqPacket::pair().unwrap();
    let of = |faults: &[Fault]| {
        let injector = Injector::counting();
        injector.set(faults.iter().copied());
        let _installed = injector.install();
        PeerProcess::of(&socket)
    };
    let old = failing(1, libc::ENOPROTOOPT);
    for errno in [libc::ENOSYS, libc::EPERM] {
        let told = of(&[old, failing(2, errno)]);
        assert!(matches!(told, Ok(PeerProcess::Unknown)), "{told:?}");
    }
    let reaped = of(&[old, failing(2, libc::ESRCH)]);
    assert!(matches!(reaped, Ok(PeerProcess::Ended)), "{reaped:?}");
    for faults in [
        vec![failing(1, libc::EMFILE)],
        vec![old, failing(2, libc::EMFILE)],
    ] {
        let error = of(&faults).unwrap_err();
        assert_eq!(error.raw_os_error(), Some(libc::EMFILE));
    }
}

/// A program that `nohup` has started ignores SIGHUP, and asks so before it catches signals.
#[test]
fn the_signals_that_a_process_ignores_are_told() {
    if ran_alone(concat!(
        module_path!(),
        "::the_signals_that_a_process_ignores_are_told"
    )) {
        return;
    }
    let ignored = [1, 2, 10, 31, 34, 64];
    for number in 1..=64 {
        let action = if ignored.contains(&number) {
            libc::SIG_IGN
        } else {
            libc::SIG_DFL
        };
        // SAFETY: neither action runs code of this program. The call refuses the signals that nobody may ignore.
        unsafe { libc::signal(number, action) };
    }
    // The C library keeps two of them for itself, which may be ignored since the program began.
    let told: Vec<i32> = (-1..=130)
        .filter(|it| ![32, 33].contains(it) && is_signal_ignored(*it))
        .collect();
    assert_eq!(told, ignored);
}

/// The numbers below 256 that have a descriptor. Allocates nothing, so that a forked child can call it.
fn open_numbers() -> i32 {
    // SAFETY: the call reads the flags of a descriptor, if there is one.
    let is_open = |number: &i32| unsafe { libc::fcntl(*number, libc::F_GETFD) != -1 };
    (0..256).filter(is_open).map(|_| 1).sum()
}

/// The copies that a child has of sockets are replaced, and the replacement itself is closed.
//= SM2-SES-011 test
#[test]
fn a_forked_child_has_as_many_descriptors_as_its_parent() {
    if ran_alone(concat!(
        module_path!(),
        "::a_forked_child_has_as_many_descriptors_as_its_parent"
    )) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s");
    let listener = Listener::bind(&path, 16).unwrap();
    let clients = [(); 3].map(|()| SeqPacket::connect(&path).unwrap());
    let accepted = [(); 3].map(|()| listener.accept().unwrap().unwrap());
    let (mut line, mut of_child) = UnixStream::pair().unwrap();
    let before = open_numbers();
    // SAFETY: the child uses system calls only, and ends.
    let child = match unsafe { fork() }.unwrap() {
        ForkResult::Child => {
            let _ = of_child.write_all(&open_numbers().to_ne_bytes());
            // Until the parent has ended the connections.
            let _ = of_child.read(&mut [0]);
            // SAFETY: ends the child without running anything else of the test program.
            unsafe { libc::_exit(0) }
        }
        ForkResult::Parent { child } => child,
    };
    line.set_read_timeout(Some(SOON)).unwrap();
    let mut count = [0; 4];
    line.read_exact(&mut count).unwrap();
    assert_eq!(i32::from_ne_bytes(count), before);
    drop((accepted, listener));
    for client in clients {
        assert!(matches!(client.recv(&mut [0; 8]), Err(RecvError::Closed)));
    }
    line.write_all(b"x").unwrap();
    assert_eq!(waitpid(child, None).unwrap(), WaitStatus::Exited(child, 0));
}
