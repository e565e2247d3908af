//! A node whose link the test controls.

use std::io::IoSlice;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

use sm2_io::{RecvError, SeqPacket, wait_readable};
use sm2_node::domain::{LinkId, OfferedQos};
use sm2_node::{Message, Name, Subscriber};
use sm2_proto::node::{Input, Node, Output};
use sm2_proto::{Contract, Datagram, Machine};

use super::{Domain, SOON};

pub(crate) const SENDER: u8 = 0;
pub(crate) const RECEIVER: u8 = 1;

/// A node that obeys the protocol towards the Manager, and gives the test control of its link.
pub(crate) struct Raw {
    _session: SeqPacket,
    link: SeqPacket,
    id: LinkId,
}

impl Raw {
    pub(crate) fn declare(domain: &Domain, name: &str, contract: &Contract) -> Self {
        let session = SeqPacket::connect(&domain.socket()).unwrap();
        let mut node = Node::new(Name::new(name).unwrap());
        let mut buffer = vec![0; 65_536];
        loop {
            let mut fd = None;
            while let Some(output) = node.poll() {
                match output {
                    Output::Transmit(frame) => session.send(&[IoSlice::new(&frame)], &[]).unwrap(),
                    Output::Welcomed { .. } => drop(node.declare(contract.clone()).unwrap()),
                    Output::Declared { .. } => {}
                    other => panic!("{other:?}"),
                }
            }
            wait_readable(&[session.as_fd()], Some(SOON)).unwrap();
            let received = session.recv(&mut buffer).unwrap();
            fd = received.fds.into_iter().next().or(fd);
            let bytes = &buffer[..received.len];
            let facts = vec![Default::default(); usize::from(fd.is_some())];
            let datagram = Datagram {
                fds: &facts,
                ..Datagram::new(bytes)
            };
            let _ = node.handle(sm2_node::now(), Input::Datagram(datagram));
            if let Some(fd) = fd {
                let link = SeqPacket::from_fd(fd).unwrap();
                let Some(Output::Linked { link: id, .. }) = node.poll() else {
                    panic!("a descriptor without a link");
                };
                return Self {
                    _session: session,
                    link,
                    id,
                };
            }
        }
    }

    pub(crate) fn open(&self, role: u8, window: u32) {
        let mut frame = vec![1, role, 1, 0];
        frame.extend(window.to_le_bytes());
        frame.extend(self.id.epoch.to_le_bytes());
        frame.extend(self.id.serial.to_le_bytes());
        frame.extend(1_u32.to_le_bytes());
        let max_len: u32 = if role == SENDER { 0 } else { 1 << 20 };
        frame.extend(max_len.to_le_bytes());
        // It does not say who it is and what it has published.
        frame.extend([0; 16]);
        self.send(&frame, &[]);
    }

    pub(crate) fn send(&self, frame: &[u8], fds: &[BorrowedFd<'_>]) {
        self.link.send(&[IoSlice::new(frame)], fds).unwrap();
    }

    /// Returns the code of the CLOSE, and checks that no other frame follows.
    pub(crate) fn closed(&self, mut drive: impl FnMut()) -> u16 {
        let deadline = Instant::now() + SOON;
        let mut buffer = vec![0; 65_536];
        let mut code = None;
        while Instant::now() < deadline {
            drive();
            wait_readable(&[self.link.as_fd()], Some(Duration::from_millis(1))).unwrap();
            match self.link.recv(&mut buffer) {
                Ok(received) if buffer[0] == 9 => {
                    assert_eq!((code, received.len), (None, 8));
                    code = Some(u16::from_le_bytes([buffer[2], buffer[3]]));
                }
                Ok(_) => assert_eq!(code, None, "nothing follows CLOSE"),
                Err(RecvError::WouldBlock) => {}
                Err(RecvError::Closed) => return code.expect("CLOSE"),
                Err(error) => panic!("{error}"),
            }
        }
        panic!("the link is not closed");
    }
}

pub(crate) fn topic() -> Name {
    Name::new("topic").unwrap()
}

pub(crate) fn raw_publisher(domain: &Domain) -> (Raw, Subscriber<[u8]>) {
    let subscriber = domain.node("listener").subscriber::<[u8]>("topic").unwrap();
    let contract = Contract::Publisher {
        topic: topic(),
        data: <[u8]>::type_id(),
        offer: OfferedQos::new(1),
    };
    let raw = Raw::declare(domain, "raw", &contract);
    raw.open(SENDER, 0);
    (raw, subscriber)
}

pub(crate) fn attach(segment: u32, stride: u64, slots: u32) -> Vec<u8> {
    let mut frame = vec![2, 0, 0, 0];
    frame.extend(segment.to_le_bytes());
    frame.extend(stride.to_le_bytes());
    frame.extend(slots.to_le_bytes());
    frame.extend([0; 4]);
    frame
}

pub(crate) fn pooled(segment: u32, slot: u32, sequence: u64, len: u64) -> Vec<u8> {
    let mut frame = vec![4, 1, 0, 0];
    frame.extend(segment.to_le_bytes());
    frame.extend(slot.to_le_bytes());
    frame.extend([0; 4]);
    for word in [sequence, sequence, 0, len] {
        frame.extend(word.to_le_bytes());
    }
    frame
}
