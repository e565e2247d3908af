//! Private memory for messages that came in cells of a ring.

use std::sync::Arc;

use sm2_io::{InUse, Reusable};
use sm2_proto::link::CellView;

use crate::driver::origin::{CellCopy, Origin};

/// How many copies are kept. A program that holds more messages of one link at a time allocates for each further one.
const KEPT: usize = 64;

/// How many copies are looked at before another one is allocated.
const LOOKS: usize = 8;

/// Copies of messages that are used again once the program has dropped their messages.
#[derive(Debug, Default)]
pub(super) struct Cells {
    kept: Vec<Reusable<CellCopy>>,
    /// The copy after the one that was used last. Messages that are taken together are dropped in order.
    next: usize,
}

impl Cells {
    /// Copies a message of this link.
    #[inline]
    pub(super) fn copy(&mut self, cell: CellView<'_>, origin: &Arc<Origin>) -> InUse<CellCopy> {
        for _ in 0..LOOKS {
            let index = if self.next < self.kept.len() {
                self.next
            } else {
                0
            };
            let Some(kept) = self.kept.get_mut(index) else {
                break;
            };
            self.next = index + 1;
            if let Some(lent) = kept.lend(|copy| copy.bytes.fill(cell)) {
                return lent;
            }
        }
        self.copy_anew(cell, origin)
    }

    #[cold]
    fn copy_anew(&mut self, cell: CellView<'_>, origin: &Arc<Origin>) -> InUse<CellCopy> {
        let mut copy = Reusable::new(CellCopy {
            bytes: cell.to_bytes(),
            origin: Arc::clone(origin),
        });
        let lent = copy.lend(|_| ()).expect("it was just made");
        if self.kept.len() < KEPT {
            self.kept.push(copy);
        }
        lent
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Weak;

    use super::*;
    use crate::driver::origin::{GiveBack, any_peer};
    use crate::driver::token::LinkToken;

    #[derive(Debug)]
    struct Nothing;

    impl GiveBack for Nothing {
        fn give_back(&self, _: LinkToken, _: u64) {}
    }

    fn copy(cells: &mut Cells, byte: u8, origin: &Arc<Origin>) -> InUse<CellCopy> {
        let words = [u64::from_le_bytes([byte; 8]); 13];
        cells.copy(CellView::new(&words, 8), origin)
    }

    #[test]
    fn a_copy_is_used_again_once_its_message_is_dropped() {
        let interface: Weak<Nothing> = Weak::new();
        let origin = Arc::new(Origin {
            token: LinkToken(1),
            peer: any_peer(),
            interface,
        });
        let mut cells = Cells::default();
        let mut held: Vec<_> = (0..100).map(|it| copy(&mut cells, it, &origin)).collect();
        assert_eq!(cells.kept.len(), KEPT, "the others are not kept");
        for (number, held) in held.iter().enumerate() {
            assert_eq!(held.bytes[..], [number as u8; 8]);
        }
        let address = |copy: &InUse<CellCopy>| copy.bytes.as_ptr() as usize;
        let kept: HashSet<_> = held[..KEPT].iter().map(address).collect();
        // One message stays, and keeps its bytes.
        let stays = held.swap_remove(7);
        drop(held);
        for byte in 100..250 {
            let next = copy(&mut cells, byte, &origin);
            assert!(kept.contains(&address(&next)) && address(&next) != address(&stays));
            assert_eq!(next.bytes[..], [byte; 8]);
            assert_eq!(stays.bytes[..], [7; 8]);
        }
    }
}
