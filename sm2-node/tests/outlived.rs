//! A process that ends while other processes still have its descriptors.

use std::fs;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

use nix::sys::signal::{Signal, kill};
use nix::sys::wait::waitpid;
use nix::unistd::{ForkResult, Pid, fork, getpid};
use sm2_manager::{Background, Options};
use sm2_node::Node;
use sm2_test_support::ran_alone;

use crate::common::{Domain, LANES, SOON, next, until};

/// Declares a publisher, makes a child by `fork(2)`, publishes, and is killed. The child has all descriptors, says its
/// number, and lives until the other end of `line` is closed.
fn register_fork_and_die(domain: &Domain, ring: bool, mut line: UnixStream) -> ! {
    let node = domain.builder("registrant").ring_lane(ring).connect();
    let node = node.unwrap();
    let publisher = node.publisher::<str>("topic").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    // SAFETY: the child reads, writes and ends, and runs nothing else.
    if let ForkResult::Child = unsafe { fork() }.unwrap() {
        let number = getpid().as_raw().to_ne_bytes();
        let _ = line.write_all(&number);
        let _ = line.read(&mut [0]);
        // SAFETY: ends this process without running anything else of the test program.
        unsafe { nix::libc::_exit(0) }
    }
    publisher.publish("last words").unwrap();
    kill(getpid(), Signal::SIGKILL).unwrap();
    unreachable!("killed");
}

/// The child of a process keeps neither its name nor its links.
//= SM2-SES-011 test
#[test]
fn a_forked_child_does_not_keep_the_session_of_its_parent() {
    if ran_alone(concat!(
        module_path!(),
        "::a_forked_child_does_not_keep_the_session_of_its_parent"
    )) {
        return;
    }
    for ring in LANES {
        let domain = Domain::new();
        let (mut hold, line) = UnixStream::pair().unwrap();
        // SAFETY: the C library makes its allocator usable in the child. Beside this thread, only the Manager has one,
        // of whose state the child uses nothing.
        if let ForkResult::Child = unsafe { fork() }.unwrap() {
            drop(hold);
            register_fork_and_die(&domain, ring, line);
        }
        drop(line);
        let subscriber = domain.node_on(ring, "listener").subscriber::<str>("topic");
        let subscriber = subscriber.unwrap();
        assert_eq!(&*next(&subscriber), "last words");
        until(|| subscriber.links().iter().all(|link| link.end.is_some()));
        // The name is free, and the child still lives.
        assert!(domain.node("registrant").is_connected());
        let mut number = [0; 4];
        hold.read_exact(&mut number).unwrap();
        kill(Pid::from_raw(i32::from_ne_bytes(number)), None).unwrap();
    }
}

/// Serves a domain until it is killed. After the first byte on `line`, makes a child by `fork(2)`, which has all
/// descriptors, drops its copy of the Manager, says its number, and lives until the other end of `line` is closed.
fn serve_fork_and_wait(socket: &Path, mut line: UnixStream) -> ! {
    let manager = Background::start(socket, Options::default()).unwrap();
    line.write_all(&[0]).unwrap();
    line.read_exact(&mut [0]).unwrap();
    // SAFETY: the child drops a handle, reads, writes and ends, and runs nothing else.
    if let ForkResult::Child = unsafe { fork() }.unwrap() {
        drop(manager);
        let number = getpid().as_raw().to_ne_bytes();
        let _ = line.write_all(&number);
        let _ = line.read(&mut [0]);
        // SAFETY: ends this process without running anything else of the test program.
        unsafe { nix::libc::_exit(0) }
    }
    loop {
        thread::park();
    }
}

/// The child of a process that embeds a Manager keeps neither the domain nor the sessions of its nodes.
#[test]
fn a_forked_child_does_not_keep_the_domain_of_its_parent() {
    if ran_alone(concat!(
        module_path!(),
        "::a_forked_child_does_not_keep_the_domain_of_its_parent"
    )) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("domain.sock");
    let (mut hold, line) = UnixStream::pair().unwrap();
    hold.set_read_timeout(Some(SOON)).unwrap();
    // SAFETY: this process has one thread beside that of the test harness, which holds no lock that the child needs.
    let ForkResult::Parent { child: server } = unsafe { fork() }.unwrap() else {
        drop(hold);
        serve_fork_and_wait(&socket, line);
    };
    drop(line);
    hold.read_exact(&mut [0]).unwrap();
    let node = Node::builder("node").socket(&socket).connect().unwrap();
    hold.write_all(&[0]).unwrap();
    let mut number = [0; 4];
    hold.read_exact(&mut number).unwrap();
    // The child has dropped its copy of the Manager, which serves as before.
    let other = Node::builder("other").socket(&socket).connect().unwrap();
    assert!(node.is_connected() && other.is_connected());
    kill(server, Signal::SIGKILL).unwrap();
    waitpid(server, None).unwrap();
    until(|| !node.is_connected());
    let _next = Background::start(&socket, Options::default()).unwrap();
    until(|| node.is_connected());
    // The child lives.
    kill(Pid::from_raw(i32::from_ne_bytes(number)), None).unwrap();
}

/// A program that is started by `posix_spawn(3)` or `exec(3)` gets no descriptor of a node.
#[test]
fn a_program_that_is_started_inherits_nothing() {
    let domain = Domain::new();
    let node = domain.node("parent");
    let publisher = node.publisher::<str>("topic").unwrap();
    let subscriber = node.subscriber::<str>("topic").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    // In a slot, so that the node has a segment as well.
    let hello = "hello ".repeat(20);
    publisher.publish(&hello).unwrap();
    let sample = next(&subscriber);
    let mut command = Command::new("sleep");
    command.arg("600").stdin(Stdio::null());
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let folder = format!("/proc/{}", child.id());
    // On an emulated processor, the child has the descriptors of this process until it becomes the other program.
    until(|| fs::read_to_string(format!("{folder}/comm")).unwrap() == "sleep\n");
    let descriptors = fs::read_dir(folder + "/fd").unwrap().map(|it| {
        let path = it.unwrap().path();
        fs::read_link(path).unwrap_or_default()
    });
    let descriptors: Vec<_> = descriptors.collect();
    child.kill().unwrap();
    child.wait().unwrap();
    let of_nodes = ["socket:", "/memfd:", "anon_inode:"];
    let inherited = descriptors.iter().filter(|it| {
        let text = it.to_string_lossy();
        of_nodes.iter().any(|kind| text.starts_with(kind))
    });
    assert_eq!(inherited.count(), 0, "{descriptors:?}");
    assert_eq!(&*sample, hello);
}
