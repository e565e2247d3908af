//! A standby's session with the Manager that serves.

use std::{
    io::{self, IoSlice},
    os::fd::AsFd,
    process,
};

use sm2_io::{RecvError, SeqPacket, clock, wait_readable};
use sm2_proto::{
    Datagram, Farewell, Machine, Name, Refusal,
    limits::DATAGRAM_MAX,
    manager::STANDBY_PREFIX,
    node::{Input, Node, Output},
};
use tracing::debug;

use crate::handles::Handles;

/// A node without interfaces.
#[derive(Debug)]
pub(super) struct StandbyNode {
    socket: SeqPacket,
    machine: Node,
    /// How many names have been tried.
    tried: u32,
    welcomed: bool,
}

/// The reason why the session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// The standby is to stop.
    Stopped,
    /// The Manager or its connection ended.
    Ended,
    /// The same, but before the Manager sent WELCOME.
    NotWelcomed,
}

impl StandbyNode {
    /// Starts a session on a connected socket with HELLO.
    pub(super) fn new(socket: SeqPacket) -> Self {
        let mut standby = Self {
            socket,
            machine: Node::new(name(1)),
            tried: 1,
            welcomed: false,
        };
        standby.carry_out();
        standby
    }

    /// Waits until the session ends.
    pub(super) fn sit(mut self, handles: &Handles) -> io::Result<Over> {
        let mut buffer = vec![0; DATAGRAM_MAX + 1];
        while self.machine.end().is_none() {
            let wakers = [&handles.stop, &handles.hand_over].map(|waker| waker.as_fd());
            wait_readable(&[self.socket.as_fd(), wakers[0], wakers[1]], None)?;
            // A standby has nothing to hand over.
            handles.hand_over.drain();
            if handles.is_stopped()? {
                self.feed(Input::Close(Farewell::Done.code()));
                return Ok(Over::Stopped);
            }
            self.receive(&mut buffer);
        }
        Ok(if self.welcomed {
            Over::Ended
        } else {
            Over::NotWelcomed
        })
    }

    fn receive(&mut self, buffer: &mut [u8]) {
        match self.socket.recv(buffer) {
            Ok(received) => {
                // No frame for such a node carries descriptors.
                let facts = vec![sm2_proto::FdFacts::default(); received.fds.len()];
                self.feed(Input::Datagram(Datagram {
                    bytes: &buffer[..received.len],
                    fds: &facts,
                    data_truncated: received.data_truncated,
                    control_truncated: received.control_truncated,
                }));
            }
            Err(RecvError::WouldBlock) => {}
            Err(RecvError::Closed) => self.feed(Input::Eof),
            Err(RecvError::Io(error)) => {
                debug!(%error, "cannot read from the Manager");
                self.feed(Input::Eof);
            }
        }
    }

    fn feed(&mut self, input: Input<'_>) {
        // After an error the session has ended, which `sit` notices.
        let _ = self.machine.handle(clock::now(), input);
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.machine.poll() {
            match output {
                // If the socket does not accept a greeting or a goodbye, the connection has ended, and
                // reading reports that.
                Output::Transmit(frame) => {
                    let _ = self.socket.send(&[IoSlice::new(&frame)], &[]);
                }
                Output::Welcomed { .. } => self.welcomed = true,
                Output::HelloRefused(Refusal::NameTaken) => {
                    self.tried += 1;
                    let greeting = Input::Greet(name(self.tried));
                    let _ = self.machine.handle(clock::now(), greeting);
                }
                // The Manager ends the session after its greeting timeout. Then the standby tries again.
                Output::HelloRefused(reason) => debug!(%reason, "not welcome"),
                Output::Ended(end) => debug!(%end, "the standby session ended"),
                // Answers to requests that this node never sends.
                Output::TransmitCounters(_)
                | Output::Declared { .. }
                | Output::DeclareRefused { .. }
                | Output::Linked { .. }
                | Output::LinkLost { .. }
                | Output::Unlink { .. }
                | Output::Withdrawn { .. }
                | Output::Page(_)
                | Output::Changes(_)
                | Output::Inspected { .. }
                | Output::NotInspected { .. }
                | Output::Described { .. }
                | Output::Reloaded(_)
                | Output::Resumed => {}
            }
        }
    }
}

/// The nth name to try. Process ids usually differ, but not between containers.
fn name(tried: u32) -> Name {
    let pid = process::id();
    let name = match tried {
        1 => format!("{STANDBY_PREFIX}{pid}"),
        more => format!("{STANDBY_PREFIX}{pid}-{more}"),
    };
    Name::new(&name).expect("segments of letters, digits and -")
}
