//! The process at the other end of a connection.

use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use nix::libc;
use nix::sys::signal::{Signal, kill};
use nix::sys::wait::waitpid;
use nix::unistd::{ForkResult, Pid, fork, getpid};
use sm2_io::fault::{Call, Fault, Injector};
use sm2_io::{Listener, PeerProcess, SeqPacket, wait_readable};
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
