//! How many ends of links the nodes of this process can have (SM2-LNK-007).
//!
//! Each link needs descriptors, and other nodes decide how many links a node gets. So a node states how many
//! ends of links it can have: those that it has, and some *ahead*: the process has free descriptors for
//! these, which no other node of the process has ahead. A node takes at most half of the free ones at a time, so that
//! its neighbours find room as well. The first few links are granted in any case.
//!
//! The library counts two descriptors for each end of a link: its socket, and one for a segment, a ring or a sealed
//! message. A node without room looks again every 100 ms, since the program may close files of its own. If a descriptor
//! of a link is lost all the same, the node states the number of links that it has, and the pair waits.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

/// The descriptors that an end of a link may need: its socket, and another one. A publisher keeps one for each
/// segment; at the other side, a segment, a ring or a sealed message comes as a descriptor.
const PER_LINK: usize = 2;

/// The descriptors that links leave to the program, and to files of this library that do not belong to one
/// link. A process with few descriptors leaves a quarter of them.
const RESERVE: usize = 64;

/// How many links a node has ahead at most: a process may have hundreds of nodes.
const AHEAD: usize = 16;

/// How many links a node can have at least while descriptors are free, also if its neighbours have all of them ahead:
/// they may never need them. If they do, the process loses a descriptor, and the node states less (SM2-TRN-011).
const LEAST: usize = 4;

static PROCESS: LazyLock<Arc<Mutex<Books>>> = LazyLock::new(Arc::default);

/// The links of all nodes of a process.
#[derive(Debug, Default)]
struct Books {
    nodes: HashMap<u64, Counts>,
    last: u64,
}

/// The links of one node.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    /// The number that the node has stated.
    stated: usize,
    /// The ends of links that it has.
    held: usize,
}

/// The part of one node.
#[derive(Debug)]
pub(crate) struct LinkRoom {
    share: Arc<Share>,
    /// At this number of links ahead the node looks for more room.
    low: usize,
}

#[derive(Debug)]
struct Share {
    books: Arc<Mutex<Books>>,
    id: u64,
}

/// An end of a link. Its room is free again when this value is dropped, which happens before its socket is
/// closed: another node may count the descriptor twice in between, but never miss it.
#[derive(Debug)]
pub(crate) struct HeldLink(Arc<Share>);

impl Counts {
    const fn ahead(self) -> usize {
        self.stated.saturating_sub(self.held)
    }
}

impl LinkRoom {
    /// The part of a new node of this process.
    pub(crate) fn new() -> Self {
        Self::of(&PROCESS)
    }

    fn of(books: &Arc<Mutex<Books>>) -> Self {
        let mut all = lock(books);
        all.last += 1;
        let id = all.last;
        all.nodes.insert(id, Counts::default());
        drop(all);
        let books = Arc::clone(books);
        Self {
            share: Arc::new(Share { books, id }),
            low: 0,
        }
    }

    /// Notes that the node has an end of a link.
    pub(crate) fn hold(&self) -> HeldLink {
        self.share.change(|counts| counts.held += 1);
        HeldLink(Arc::clone(&self.share))
    }

    /// Looks for room for more links, if the node has few ahead. `free` returns the number of free
    /// descriptors, up to one that suffices. Returns the number to be stated if it grows.
    //= SM2-LNK-007
    pub(crate) fn look(&mut self, free: impl FnOnce(usize) -> io::Result<usize>) -> Option<u32> {
        let mut books = lock(&self.share.books);
        let ours = books.nodes.get(&self.share.id).copied()?;
        if ours.ahead() > self.low {
            return None;
        }
        let held: usize = books.nodes.values().map(|it| it.held).sum();
        let ahead: usize = books.nodes.values().map(|it| it.ahead()).sum();
        let wanted = AHEAD.saturating_sub(ours.ahead());
        // An end that is held has its socket, and may need one more descriptor.
        const { assert!(PER_LINK == 2) };
        let taken = held + ahead * PER_LINK;
        let free = free(RESERVE + taken + 2 * wanted * PER_LINK).ok()?;
        let reserve = RESERVE.min((free + held) / 4);
        let links = free.saturating_sub(reserve + taken) / PER_LINK;
        let own = held + ours.ahead() * PER_LINK;
        let unclaimed = free.saturating_sub(reserve + own) / PER_LINK;
        let least = LEAST.saturating_sub(ours.stated.max(ours.held));
        let least = least.min(unclaimed);
        let more = wanted.min(links.div_ceil(2).max(least));
        let counts = books.nodes.get_mut(&self.share.id)?;
        counts.stated = counts.stated.max(counts.held) + more;
        self.low = counts.ahead() / 2;
        let stated = counts.stated;
        drop(books);
        (more > 0).then(|| u32::try_from(stated).unwrap_or(u32::MAX))
    }

    /// A descriptor of a link was lost: the node has no room beyond the links that it has. Returns the number
    /// to be stated, if it is another one.
    //= SM2-LNK-007
    pub(crate) fn run_out(&mut self) -> Option<u32> {
        self.low = 0;
        let mut stated = None;
        self.share.change(|counts| {
            if counts.ahead() > 0 {
                counts.stated = counts.held;
                stated = Some(counts.held);
            }
        });
        stated.map(|it| u32::try_from(it).unwrap_or(u32::MAX))
    }

    /// Whether the node has no room for a link with itself, so that it has to look again.
    pub(crate) fn is_short(&self) -> bool {
        let mut ahead = 0;
        self.share.change(|counts| ahead = counts.ahead());
        ahead < 2
    }
}

impl Share {
    fn change(&self, change: impl FnOnce(&mut Counts)) {
        if let Some(counts) = lock(&self.books).nodes.get_mut(&self.id) {
            change(counts);
        }
    }
}

impl Drop for HeldLink {
    fn drop(&mut self) {
        self.0.change(|counts| counts.held -= 1);
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        lock(&self.books).nodes.remove(&self.id);
    }
}

/// The counts are consistent also after a panic of another thread: no other code runs under the lock.
fn lock(books: &Mutex<Books>) -> MutexGuard<'_, Books> {
    books.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A process with this many descriptors that links can use.
    struct Process {
        books: Arc<Mutex<Books>>,
        limit: usize,
    }

    impl Process {
        fn new(limit: usize) -> Self {
            let books = Arc::default();
            Self { books, limit }
        }

        fn node(&self) -> LinkRoom {
            LinkRoom::of(&self.books)
        }

        /// Looks for room, as long as every link has one descriptor.
        fn look(&self, room: &mut LinkRoom) -> Option<u32> {
            let held: usize = lock(&self.books).nodes.values().map(|it| it.held).sum();
            room.look(|at_most| Ok((self.limit - held).min(at_most)))
        }

        /// Gives a node as many links as it states. Returns them.
        fn fill(&self, room: &mut LinkRoom) -> Vec<HeldLink> {
            let mut links = Vec::new();
            loop {
                self.look(room);
                let mut ahead = 0;
                room.share.change(|counts| ahead = counts.ahead());
                if ahead == 0 {
                    return links;
                }
                links.push(room.hold());
            }
        }
    }

    //= SM2-LNK-007 test
    #[test]
    fn links_use_all_descriptors_but_the_reserve() {
        for (limit, links) in [(1_024, 480), (64, 24), (16, 6), (4, 1), (0, 0)] {
            let process = Process::new(limit);
            let mut room = process.node();
            let held = process.fill(&mut room);
            assert_eq!(held.len(), links, "{limit} descriptors");
            assert!(room.is_short());
        }
    }

    //= SM2-LNK-007 test
    #[test]
    fn a_node_states_no_more_ahead_than_it_needs_soon() {
        let process = Process::new(1_000_000);
        let mut room = process.node();
        assert_eq!(process.look(&mut room), Some(16));
        let mut links: Vec<_> = (0..7).map(|_| room.hold()).collect();
        assert_eq!(process.look(&mut room), None, "enough is ahead");
        links.push(room.hold());
        assert_eq!(process.look(&mut room), Some(24));
        assert!(!room.is_short());
    }

    /// The nodes of a process together state no more than it has.
    //= SM2-LNK-007 test
    #[test]
    fn a_node_leaves_room_for_its_neighbours() {
        let process = Process::new(264);
        let mut nodes = [process.node(), process.node(), process.node()];
        let stated = nodes.each_mut().map(|it| process.look(it));
        assert_eq!(stated, [Some(16), Some(16), Some(16)]);
        let held: Vec<_> = nodes.iter_mut().map(|it| process.fill(it)).collect();
        assert_eq!(held.iter().map(Vec::len).sum::<usize>(), 100);
        drop(held);
        // The room of a node that is gone is free for the others.
        let [mut one, two, three] = nodes;
        drop((two, three));
        assert_eq!(process.fill(&mut one).len(), 100);
    }

    //= SM2-LNK-007, SM2-TRN-011 test
    #[test]
    fn a_node_that_ran_out_states_what_it_has() {
        let process = Process::new(264);
        let mut room = process.node();
        process.look(&mut room);
        let links = [room.hold(), room.hold()];
        assert_eq!(room.run_out(), Some(2));
        assert_eq!(room.run_out(), None, "it is stated already");
        assert!(room.is_short());
        assert_eq!(room.look(|_| Ok(2)), None);
        assert_eq!(room.look(|_| Ok(10)), Some(4));
        drop(links);
        assert_eq!(room.look(|_| Ok(10)), None, "four links are ahead");
    }
}
