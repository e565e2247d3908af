//! Messages in cells, of the end under test and of its peer.

use alloc::vec::Vec;

use super::{super::NOW, Ring};
use crate::{
    fuzz::Script,
    limits::CELL_MAX,
    link::{At, CellMessage, CellWord, Error, Role, Status},
};

impl Ring<'_> {
    //= SM2-RNG-013 fuzz
    pub(super) fn send_in_cell(&mut self, script: &mut Script<'_>) -> Option<()> {
        self.world.own += 1;
        let role = self.role();
        let len = usize::from(script.byte()?) % (CELL_MAX + 2);
        let message = CellMessage {
            id: match role {
                Role::Server => self.some_call(script)?,
                _ => script.near(self.world.own)?,
            },
            time: NOW,
            status: Status::Ok,
            bytes: &[7; CELL_MAX + 1][..len],
        };
        let before = self.world.link.clone();
        let takes_cells = before.takes_cells(&self.outgoing);
        let most = self.most_to_send();
        let mut settled = Vec::new();
        let note = |key, fate| settled.push((key, fate));
        let result = (self.world.link).send_in_cell(&self.outgoing, &message, note);
        // One access is that of `takes_cells`.
        self.outgoing.check_accesses(most + 1);
        let is_sent = match result {
            Ok(_) => {
                assert!(len <= CELL_MAX && before.is_open());
                true
            }
            Err(Error::Misuse(misuse)) => {
                assert_eq!(self.world.link, before, "misuse changes nothing: {misuse}");
                false
            }
            // This call ended the link, and the message counts as closed.
            Err(Error::Ended(_)) if before.end().is_none() => true,
            Err(Error::Ended(end)) => {
                assert_eq!(before.end(), Some(end));
                assert!(!takes_cells);
                false
            }
        };
        if is_sent {
            self.world.in_cells += 1;
            match role {
                Role::Caller => assert!(self.calls.insert(message.id), "ids grow"),
                Role::Server => assert!(self.calls.remove(&message.id), "it had no reply"),
                Role::Sender | Role::Receiver => {}
            }
        }
        self.settle(&settled);
        Some(())
    }

    /// The peer puts the next message in its cell, which is usually correct.
    pub(super) fn peer_puts_cell(&mut self, script: &mut Script<'_>) -> Option<()> {
        let sequence = script.near(self.put + 1)?;
        let right = match self.role() {
            Role::Caller => self.some_call(script)?,
            // Greater than the ids of all messages in slots that come before it.
            _ => (self.put + 1) << 16,
        };
        let id = script.near(right)?;
        let status = match (self.role(), script.byte()?) {
            (Role::Caller, 0xf0..=0xf7) | (_, 0xff) => Status::Failed,
            (Role::Caller, 0xf8..) => Status::Cancelled,
            _ => Status::Ok,
        };
        let len = usize::from(script.byte()?) % (CELL_MAX + 1);
        let len = len * usize::from(status.has_payload() || script.rarely()?);
        let index = (sequence % self.incoming.depth()) as u32;
        self.incoming.set_cell(index, &[id, 9, 7, 7]);
        let word = CellWord::new(len, status, sequence)?;
        self.incoming.set(At::Forward(index), word.to_bits());
        self.put += 1;
        Some(())
    }
}
