//! Farewells: one per end of a link and direction of a session.

use std::collections::BTreeMap;

use sm2_proto::{InterfaceId, LinkId};

/// The side that sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Manager,
    Node,
}

/// The ends of links that are named in one session and whose farewells are not complete.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Books(BTreeMap<(InterfaceId, LinkId), Book>);

/// One record per end. Arrays are indexed by side: the Manager, then the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Book {
    /// The sides that have named the end, or received its name.
    knows: [bool; 2],
    /// The sides that have sent their farewell.
    said: [bool; 2],
    /// The sides that have read the farewell of the other side.
    read: [bool; 2],
}

impl Books {
    /// Records that a side names an end for the first time. Returns an error text if that is wrong.
    pub(super) fn name(
        &mut self,
        side: Side,
        interface: InterfaceId,
        link: LinkId,
    ) -> Option<String> {
        let mut knows = [false; 2];
        knows[side as usize] = true;
        let [said, read] = [[false; 2]; 2];
        let book = Book { knows, said, read };
        let before = self.0.insert((interface, link), book);
        before.map(|_| format!("{link} of {interface} is named twice"))
    }

    /// Records that a side reads that name.
    pub(super) fn hear(&mut self, side: Side, interface: InterfaceId, link: LinkId) {
        if let Some(book) = self.0.get_mut(&(interface, link)) {
            book.knows[side as usize] = true;
        }
    }

    /// Records that a side sends its farewell. Returns an error text if that is wrong.
    //= SM2-LNK-003 model
    pub(super) fn farewell(
        &mut self,
        side: Side,
        interface: InterfaceId,
        link: LinkId,
    ) -> Option<String> {
        let side = side as usize;
        let book = self.0.get_mut(&(interface, link));
        let Some(book) = book.filter(|it| it.knows[side] && !it.said[side]) else {
            return Some(format!(
                "{link} of {interface} has no such farewell to come"
            ));
        };
        book.said[side] = true;
        self.close(interface, link);
        None
    }

    /// Records that a side reads the other's farewell. After both farewells were read, the end is
    /// forgotten.
    pub(super) fn read(&mut self, side: Side, interface: InterfaceId, link: LinkId) {
        let Some(book) = self.0.get_mut(&(interface, link)) else {
            return;
        };
        book.read[side as usize] = true;
        self.close(interface, link);
    }

    fn close(&mut self, interface: InterfaceId, link: LinkId) {
        let book = self.0.get(&(interface, link));
        if book.is_some_and(|it| it.said == [true; 2] && it.read == [true; 2]) {
            self.0.remove(&(interface, link));
        }
    }

    /// The Manager reads nothing more, and owes no farewells.
    pub(super) fn manager_ends(&mut self) {
        for book in self.0.values_mut() {
            book.read[Side::Manager as usize] = true;
        }
        self.0
            .retain(|_, it| it.said != [true; 2] || it.read != [true; 2]);
    }

    /// Forgets an interface with all its ends.
    pub(super) fn forget(&mut self, interface: InterfaceId) {
        self.0.retain(|(of, _), _| *of != interface);
    }

    /// True if a side has sent its farewell for an end.
    pub(super) fn has_said(&self, side: Side, interface: InterfaceId, link: LinkId) -> bool {
        let book = self.0.get(&(interface, link));
        book.is_some_and(|it| it.said[side as usize])
    }

    pub(super) fn ends(&self) -> impl Iterator<Item = &(InterfaceId, LinkId)> {
        self.0.keys()
    }

    /// Returns an end whose farewell was sent, while not both farewells were read.
    pub(super) fn half_said(&self) -> Option<(InterfaceId, LinkId)> {
        let half = self.0.iter().find(|(_, it)| it.said.contains(&true));
        half.map(|(end, _)| *end)
    }
}
