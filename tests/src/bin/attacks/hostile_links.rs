//! Processes that attack through the link with the victim's subscriber.

use std::{os::fd::AsFd, path::Path};

use sm2_io::{SendError, SeqPacket};
use sm2_proto::control::ToNode;
use sm2_tests::{
    control::{self, Qos},
    link::{Open, attach, kind, pooled, role, sealed},
    memory,
    raw::{RawNode, RawPeer},
};

use crate::victims::TOPIC;

/// The length of a file with holes: just less than the longest message that a subscriber accepts.
const FILE_BYTES: u64 = 900_000_000;
const SEGMENT_BYTES: u64 = 1 << 40;

/// Declares a publisher, and opens its link with the victim's subscriber.
fn link(node: &RawNode, interface: u64, qos: Qos) -> RawPeer {
    let contract = control::publisher(TOPIC, qos);
    node.send(control::declare(interface, &contract));
    loop {
        let (frame, fds) = node.next_with_fds();
        if let ToNode::Link { link, .. } = frame {
            let fd = fds.into_iter().next().expect("a socket");
            let end = RawPeer::new(SeqPacket::from_fd(fd).expect("a socket"));
            end.send(Open::new(role::SENDER, link, 0).bytes());
            let _ = end.next_frame();
            return end;
        }
    }
}

/// Breaks the protocol of the link, declares the next interface, and so on.
pub(crate) fn violator(socket: &Path, name: &str) {
    let node = RawNode::welcomed(socket, name);
    println!("ready");
    for interface in 1.. {
        let end = link(&node, interface, Qos::PLAIN);
        // A message in a segment that was never attached.
        let _ = end.try_send(&pooled(kind::DATA, 1, 77, 0, 10), &[]);
        while end.next_frame().is_some() {}
        node.send(control::withdraw(interface));
    }
}

/// Sends sealed files of nothing but holes, as fast as they are taken.
pub(crate) fn sparse_files(socket: &Path, name: &str) {
    let node = RawNode::welcomed(socket, name);
    let end = link(&node, 1, Qos::SEALED);
    let file = memory::sealed(FILE_BYTES);
    println!("ready");
    for number in 1.. {
        end.send_fds(sealed(kind::DATA, number, FILE_BYTES), &[file.as_fd()]);
        let _ = end.next_frame();
    }
}

/// Attaches segments until the link ends, and again on the next link.
pub(crate) fn sparse_segments(socket: &Path, name: &str) {
    let node = RawNode::welcomed(socket, name);
    let file = memory::segment(SEGMENT_BYTES);
    println!("ready");
    for interface in 1.. {
        let end = link(&node, interface, Qos::PLAIN);
        for segment in 1.. {
            let frame = attach(segment, SEGMENT_BYTES, 1);
            if matches!(
                end.try_send(&frame, &[file.as_fd()]),
                Err(SendError::Closed)
            ) {
                break;
            }
        }
        node.send(control::withdraw(interface));
    }
}
