//! Mappings of the files of peers, and the bound for their bytes.
//!
//! A sparse file costs its author nothing, whatever its size, but a mapping of the file takes
//! addresses of this process. So the mappings of all peers together are bounded, and each peer
//! leaves room for the others: the mappings of a peer take at most as many bytes as are free.

use std::collections::HashMap;
use std::io;
use std::ops::Deref;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sm2_io::memfd::{PooledFile, SealedFile};
use sm2_io::{PooledMapping, SealedMapping};
use sm2_proto::NodeId;

/// A node, and the epoch of its Manager.
type Peer = (u64, NodeId);

/// The bytes that one node maps for its peers.
#[derive(Debug)]
pub(crate) struct MappingQuota {
    books: Arc<Mutex<Books>>,
}

#[derive(Debug)]
struct Books {
    limit: u64,
    total: u64,
    /// The bytes of each peer. No entry is 0.
    peers: HashMap<Peer, u64>,
}

/// The part of one peer.
#[derive(Debug)]
pub(crate) struct PeerQuota {
    books: Arc<Mutex<Books>>,
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
     of which a peer may take half; NodeBuilder::max_mapped_bytes sets the bound"
)]
pub(crate) struct QuotaExceeded {
    bytes: u64,
    peer_bytes: u64,
    free_bytes: u64,
    limit: u64,
}

impl MappingQuota {
    pub(crate) fn new(limit_bytes: u64) -> Self {
        Self {
            books: Arc::new(Mutex::new(Books {
                limit: limit_bytes,
                total: 0,
                peers: HashMap::new(),
            })),
        }
    }

    /// The part of the node with this number in the epoch of a Manager.
    pub(crate) fn peer(&self, epoch: u64, node: NodeId) -> Arc<PeerQuota> {
        Arc::new(PeerQuota {
            books: Arc::clone(&self.books),
            peer: (epoch, node),
        })
    }
}

impl PeerQuota {
    /// Takes `bytes` for a mapping.
    //= SM2-SEG-006
    fn reserve(self: &Arc<Self>, bytes: u64) -> Result<MappedBytes, QuotaExceeded> {
        let mut books = self.lock();
        let peer_bytes = books.peers.get(&self.peer).copied().unwrap_or(0);
        let free_bytes = books.limit.saturating_sub(books.total);
        let wanted = peer_bytes.saturating_add(bytes);
        if bytes > free_bytes || wanted > free_bytes - bytes {
            return Err(QuotaExceeded {
                bytes,
                peer_bytes,
                free_bytes,
                limit: books.limit,
            });
        }
        if bytes > 0 {
            books.peers.insert(self.peer, wanted);
            books.total += bytes;
        }
        drop(books);
        Ok(MappedBytes {
            quota: Arc::clone(self),
            bytes,
        })
    }

    fn give_back(&self, bytes: u64) {
        let mut books = self.lock();
        books.total -= bytes;
        if let Some(used) = books.peers.get_mut(&self.peer) {
            *used -= bytes;
            if *used == 0 {
                books.peers.remove(&self.peer);
            }
        }
    }

    /// The sums are consistent also after a panic of another thread: no other code runs under the lock.
    fn lock(&self) -> MutexGuard<'_, Books> {
        self.books.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for MappedBytes {
    fn drop(&mut self) {
        self.quota.give_back(self.bytes);
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

    //= SM2-SEG-006 test
    #[test]
    fn a_peer_takes_as_much_as_stays_free() {
        let quota = MappingQuota::new(100);
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
        let quota = MappingQuota::new(10);
        let peer = quota.peer(1, NodeId(1));
        for _ in 0..3 {
            let held: Vec<_> = (0..5).map(|_| peer.reserve(1).unwrap()).collect();
            assert!(peer.reserve(1).is_err());
            drop(held);
        }
        let books = quota.books.lock().unwrap();
        assert_eq!((books.total, books.peers.len()), (0, 0));
    }

    #[test]
    fn nothing_costs_nothing() {
        let quota = MappingQuota::new(0);
        assert!(quota.peer(1, NodeId(1)).reserve(0).is_ok());
        assert!(quota.peer(1, NodeId(1)).reserve(1).is_err());
    }
}
