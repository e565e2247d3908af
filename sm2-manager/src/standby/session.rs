//! A standby's session with the Manager whose end it waits for.

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

/// A node that asks for nothing.
#[derive(Debug)]
pub(super) struct Session {
    socket: SeqPacket,
    machine: Node,
    /// How many names it has tried.
    tried: u32,
    welcomed: bool,
}

/// What ended it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// The standby is to stop.
    Stopped,
    /// The Manager, or its end.
    Ended,
    /// The same, before it had granted the greeting.
    NotWelcomed,
}

impl Session {
    /// Greets the Manager at the other end.
    pub(super) fn new(socket: SeqPacket) -> Self {
        let mut session = Self {
            socket,
            machine: Node::new(name(1)),
            tried: 1,
            welcomed: false,
        };
        session.carry_out();
        session
    }

    /// Waits for the session's end.
    pub(super) fn sit(mut self, handles: &Handles) -> io::Result<Over> {
        let mut buffer = vec![0; DATAGRAM_MAX + 1];
        while self.machine.end().is_none() {
            let wakers = [&handles.stop, &handles.hand_over].map(|waker| waker.as_fd());
            wait_readable(&[self.socket.as_fd(), wakers[0], wakers[1]], None)?;
            // There is nothing to hand over.
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
                // Nothing that a node of this kind is sent has descriptors.
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
        // An error says why the session is over, which `sit` sees.
        let _ = self.machine.handle(clock::now(), input);
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.machine.poll() {
            match output {
                // Whoever does not take a greeting or a goodbye has ended, and reading
                // says so.
                Output::Transmit(frame) => {
                    let _ = self.socket.send(&[IoSlice::new(&frame)], &[]);
                }
                Output::Welcomed { .. } => self.welcomed = true,
                Output::HelloRefused(Refusal::NameTaken) => {
                    self.tried += 1;
                    let greeting = Input::Greet(name(self.tried));
                    let _ = self.machine.handle(clock::now(), greeting);
                }
                // The Manager ends it after the time to greet. Then all is tried again.
                Output::HelloRefused(reason) => debug!(%reason, "not welcome"),
                Output::Ended(end) => debug!(%end, "no standby any more"),
                // Answers to what was never asked.
                Output::TransmitCounters(_)
                | Output::Declared { .. }
                | Output::DeclareRefused { .. }
                | Output::Linked { .. }
                | Output::Unlink { .. }
                | Output::Withdrawn { .. }
                | Output::Page { .. }
                | Output::Changes { .. }
                | Output::Inspected { .. }
                | Output::NotInspected { .. }
                | Output::Described { .. }
                | Output::Resumed => {}
            }
        }
    }
}

/// The name that is tried as the nth. The process id differs as a rule, but not between
/// containers.
fn name(tried: u32) -> Name {
    let pid = process::id();
    let name = match tried {
        1 => format!("{STANDBY_PREFIX}{pid}"),
        more => format!("{STANDBY_PREFIX}{pid}-{more}"),
    };
    Name::new(&name).expect("segments of letters, digits and -")
}
