use std::{io::Write, os::unix::net::UnixStream};

use sm2_manager::Background;
use sm2_test_support::SOON;

use super::*;

fn pair() -> (UnixStream, UnixStream) {
    UnixStream::pair().unwrap()
}

#[test]
fn descriptors_are_ready_that_have_something_or_are_at_their_end() {
    let (full, writer) = pair();
    let (ended, other) = pair();
    let (idle, _held) = pair();
    (&writer).write_all(b"x").unwrap();
    drop(other);
    // A child that another test is starting may have the other end for a moment.
    assert_eq!(readable(&[ended.as_fd()], Some(SOON)).unwrap(), [true]);
    let fds = [full.as_fd(), idle.as_fd(), ended.as_fd()];
    let ready = readable(&fds, Some(SOON)).unwrap();
    assert_eq!(ready, [true, false, true]);
    let nothing = readable(&[idle.as_fd()], Some(Duration::from_millis(1))).unwrap();
    assert_eq!(nothing, [false]);
}

/// The node is driven meanwhile: its links to others do not wait for the pause.
#[test]
fn a_pause_ends_at_its_time_or_by_the_stop() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("demo.sock");
    let _manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
    let node = |name| Node::builder(name).socket(&socket).connect().unwrap();
    let (here, there) = (node("here"), node("there"));
    let (stop, writer) = pair();
    let _publisher = here.publisher::<u32>("numbers").unwrap();
    let _subscriber = there.subscriber::<u32>("numbers").unwrap();
    for _ in 0..10 {
        let end = clock::now().after(Duration::from_millis(5));
        assert!(!pause(&here, stop.as_fd(), end).unwrap());
        assert!(clock::now() >= end);
    }
    (&writer).write_all(b"x").unwrap();
    let late = clock::now().after(SOON);
    assert!(pause(&here, stop.as_fd(), late).unwrap());
    assert!(clock::now() < late);
}
