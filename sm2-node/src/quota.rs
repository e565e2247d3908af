//! Mappings of the files of peers, and the bound for their bytes.
//!
//! A sparse file costs its author nothing, whatever its size, but a mapping of the file takes
//! addresses of this process. So the mappings of all peers together are bounded, and each peer
//! leaves room for the others: the mappings of a peer take at most as many bytes as are free. All nodes of a
//! process share one bound, and each has its own one as well.
//!
//! The bound counts addresses and not memory, because files with holes are mapped without populating them
//! (SM2-PAY-009).

use std::collections::HashMap;
use std::io;
use std::ops::Deref;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use sm2_io::memfd::{PooledFile, SealedFile};
use sm2_io::{PooledMapping, SealedMapping};
use sm2_proto::NodeId;

/// A node, and the epoch of its Manager.
type Peer = (u64, NodeId);

/// The bytes that all nodes of this process map for their peers.
static PROCESS: LazyLock<Arc<Mutex<Books>>> = LazyLock::new(Arc::default);

/// The bytes that one node maps for its peers.
#[derive(Debug)]
pub(crate) struct MappingQuota {
    /// Those of the node, and those of its process.
    books: [Arc<Mutex<Books>>; 2],
}

#[derive(Debug, Default)]
struct Books {
    limit: u64,
    total: u64,
    /// The bytes of each peer. No entry is 0.
    peers: HashMap<Peer, u64>,
}

/// The part of one peer.
#[derive(Debug)]
pub(crate) struct PeerQuota {
    books: [Arc<Mutex<Books>>; 2],
    peer: Peer,
}

/// Bytes that are mapped for a peer. They are free again when this value is dropped.
#[derive(Debug)]
struct MappedBytes {
    quota: Arc<PeerQuota>,
    bytes: u64,
}

/// A mapped segment of a peer.
#[derive(Debug)]
pub(crate) struct MappedSegment {
    mapping: PooledMapping,
    /// Last, so that the bytes are free after they are unmapped.
    _bytes: MappedBytes,
}

/// A mapped file of a peer with one sealed message.
#[derive(Debug)]
pub(crate) struct MappedFile {
    mapping: SealedMapping,
    /// Last, so that the bytes are free after they are unmapped.
    _bytes: MappedBytes,
}

/// A mapping for a peer would exceed the bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{bytes} more bytes are not mapped: this peer has {peer_bytes} bytes mapped, and {free_bytes} of {limit} are free, \
     and a peer may take half of these; NodeBuilder::max_mapped_bytes sets the bound"
)]
pub(crate) struct QuotaExceeded {
    bytes: u64,
    peer_bytes: u64,
    free_bytes: u64,
    limit: u64,
}

impl MappingQuota {
    /// The part of a new node of this process. The bound of the process is the greatest one of its nodes.
    pub(crate) fn new(limit_bytes: u64) -> Self {
        Self::within(&PROCESS, limit_bytes)
    }

    fn within(process: &Arc<Mutex<Books>>, limit_bytes: u64) -> Self {
        let mut all = lock(process);
        all.limit = all.limit.max(limit_bytes);
        drop(all);
        let own = Books {
            limit: limit_bytes,
            ..Books::default()
        };
        let own = Arc::new(Mutex::new(own));
        Self {
            books: [own, Arc::clone(process)],
        }
    }

    /// The part of the node with this number in the epoch of a Manager.
    pub(crate) fn peer(&self, epoch: u64, node: NodeId) -> Arc<PeerQuota> {
        Arc::new(PeerQuota {
            books: self.books.clone(),
            peer: (epoch, node),
        })
    }
}

impl PeerQuota {
    /// Takes `bytes` for a mapping.
    //= SM2-SEG-006
    fn reserve(self: &Arc<Self>, bytes: u64) -> Result<MappedBytes, QuotaExceeded> {
        let [own, process] = &self.books;
        lock(own).reserve(self.peer, bytes)?;
        if let Err(error) = lock(process).reserve(self.peer, bytes) {
            lock(own).give_back(self.peer, bytes);
            return Err(error);
        }
        Ok(MappedBytes {
            quota: Arc::clone(self),
            bytes,
        })
    }
}

impl Books {
    fn reserve(&mut self, peer: Peer, bytes: u64) -> Result<(), QuotaExceeded> {
        let peer_bytes = self.peers.get(&peer).copied().unwrap_or(0);
        let free_bytes = self.limit.saturating_sub(self.total);
        let wanted = peer_bytes.saturating_add(bytes);
        if bytes > free_bytes || wanted > free_bytes - bytes {
            return Err(QuotaExceeded {
                bytes,
                peer_bytes,
                free_bytes,
                limit: self.limit,
            });
        }
        if bytes > 0 {
            self.peers.insert(peer, wanted);
            self.total += bytes;
        }
        Ok(())
    }

    fn give_back(&mut self, peer: Peer, bytes: u64) {
        self.total -= bytes;
        if let Some(used) = self.peers.get_mut(&peer) {
            *used -= bytes;
            if *used == 0 {
                self.peers.remove(&peer);
            }
        }
    }
}

/// The sums are consistent also after a panic of another thread: no other code runs under the lock.
fn lock(books: &Mutex<Books>) -> MutexGuard<'_, Books> {
    books.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for MappedBytes {
    fn drop(&mut self) {
        for books in &self.quota.books {
            lock(books).give_back(self.quota.peer, self.bytes);
        }
    }
}

impl MappedSegment {
    /// Maps the first `len` bytes of `file`.
    pub(crate) fn new(file: &PooledFile, len: u64, quota: &Arc<PeerQuota>) -> io::Result<Self> {
        let bytes = quota.reserve(len)?;
        Ok(Self {
            mapping: PooledMapping::new(file, len, false)?,
            _bytes: bytes,
        })
    }
}

impl Deref for MappedSegment {
    type Target = PooledMapping;

    #[inline]
    fn deref(&self) -> &PooledMapping {
        &self.mapping
    }
}

impl MappedFile {
    /// Maps the first `len` bytes of `file`. All its pages are present at once, if it has no hole.
    pub(crate) fn new(file: &SealedFile, len: u64, quota: &Arc<PeerQuota>) -> io::Result<Self> {
        let bytes = quota.reserve(len)?;
        Ok(Self {
            mapping: SealedMapping::new(file, len, true)?,
            _bytes: bytes,
        })
    }
}

impl Deref for MappedFile {
    type Target = SealedMapping;

    fn deref(&self) -> &SealedMapping {
        &self.mapping
    }
}

impl From<QuotaExceeded> for io::Error {
    fn from(error: QuotaExceeded) -> Self {
        Self::new(io::ErrorKind::OutOfMemory, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quota(limit_bytes: u64) -> MappingQuota {
        MappingQuota::within(&Arc::default(), limit_bytes)
    }

    //= SM2-SEG-006 test
    #[test]
    fn the_nodes_of_a_process_share_one_bound() {
        let process = Arc::default();
        let [one, other, small] = [100, 80, 4].map(|it| MappingQuota::within(&process, it));
        let held = one.peer(1, NodeId(1)).reserve(40).unwrap();
        // The same peer at another node of the process, which has room itself.
        let peer = other.peer(1, NodeId(1));
        assert_eq!(
            peer.reserve(20).unwrap_err(),
            QuotaExceeded {
                bytes: 20,
                peer_bytes: 40,
                free_bytes: 60,
                limit: 100
            }
        );
        let more = peer.reserve(10).unwrap();
        let next = other.peer(1, NodeId(2));
        assert!(next.reserve(26).is_err(), "50 are free");
        let last = next.reserve(25).unwrap();
        assert!(
            small.peer(1, NodeId(3)).reserve(3).is_err(),
            "beyond its own bound"
        );
        drop((held, more, last));
        let [own, all] = [&other.books[0], &process].map(|it| lock(it).total);
        assert_eq!((own, all), (0, 0), "also after a refusal");
    }

    //= SM2-SEG-006 test
    #[test]
    fn a_peer_takes_as_much_as_stays_free() {
        let quota = quota(100);
        let (greedy, next) = (quota.peer(1, NodeId(1)), quota.peer(1, NodeId(2)));
        let held = [greedy.reserve(30).unwrap(), greedy.reserve(20).unwrap()];
        assert_eq!(
            greedy.reserve(1).unwrap_err(),
            QuotaExceeded {
                bytes: 1,
                peer_bytes: 50,
                free_bytes: 50,
                limit: 100
            }
        );
        // Another link of the same peer has the same part.
        assert!(quota.peer(1, NodeId(1)).reserve(1).is_err());
        let others = [
            next.reserve(25).unwrap(),
            quota.peer(2, NodeId(1)).reserve(12).unwrap(),
        ];
        assert!(next.reserve(1).is_err());
        drop(others);
        drop(held);
        assert!(greedy.reserve(51).is_err());
        assert!(greedy.reserve(u64::MAX).is_err());
        assert!(greedy.reserve(50).is_ok());
    }

    #[test]
    fn everything_is_free_again() {
        let quota = quota(10);
        let peer = quota.peer(1, NodeId(1));
        for _ in 0..3 {
            let held: Vec<_> = (0..5).map(|_| peer.reserve(1).unwrap()).collect();
            assert!(peer.reserve(1).is_err());
            drop(held);
        }
        let books = lock(&quota.books[0]);
        assert_eq!((books.total, books.peers.len()), (0, 0));
    }

    #[test]
    fn nothing_costs_nothing() {
        let quota = quota(0);
        assert!(quota.peer(1, NodeId(1)).reserve(0).is_ok());
        assert!(quota.peer(1, NodeId(1)).reserve(1).is_err());
    }
}
