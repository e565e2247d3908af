//! How much work one call does, and how much is kept.

use std::time::Duration;

use sm2_io::Event;

/// How many datagrams are read from one socket in one drive, so that no peer keeps a node busy.
pub(super) const BURST: usize = 32;

/// How many sockets are read or written in one drive.
pub(super) const SOCKETS: usize = 64;

/// How many links are ended in one drive. To end a link takes as long as many messages, and hundreds may end at once.
pub(super) const ENDS: usize = 4;

/// Puts the events of links whose other side is gone where `Vec::pop` takes them last: at the start.
pub(super) fn put_ends_last(ready: &mut [Event]) {
    if ready.len() > ENDS {
        ready.sort_unstable_by_key(|event| !event.hangup);
    }
}

/// On the ring lane: how long a call that does not need the sockets may leave them unread. An `epoll` call for each
/// message would cost more than the message.
pub(super) const SOCKETS_WAIT_NS: u64 = 100_000;

/// How long a waiting thread pauses before it uses a socket again that the kernel had no memory for.
pub(crate) const SHORTAGE_PAUSE: Duration = Duration::from_millis(1);

/// How many datagrams are read at most from a link whose other side is gone. This exceeds the
/// number of messages in a full window, each with the ATTACH of its segment.
pub(super) const LAST_WORDS: usize = 8_192;

/// How many events of an interface wait to be taken by the program; older ones are dropped and counted.
pub(super) const EVENTS: usize = 64;

/// How many ended links are listed one by one; older ones are only added to the sums.
pub(super) const HISTORY: usize = 64;

/// How many ended links may still hold messages that the application has not taken.
pub(super) const ENDED_WITH_MESSAGES: usize = 64;

/// How many changes are kept for a follower that does not fetch them.
pub(super) const CHANGES: usize = 4_096;
