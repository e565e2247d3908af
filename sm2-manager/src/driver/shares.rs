//! Fair shares of the Manager's time for its sockets.
//!
//! The driver serves its sockets in rounds of 0.2 ms, by start-time fair queueing, so a node that declares now and then
//! is served before nodes that never stop. `cargo run --release -p sm2-manager --example busy` measures it. The longest
//! piece of work took 0.70 ms of processor time, with 4,000 matches. Beside 50 processes that declared and withdrew
//! without pause on two cores, a DECLARE took 0.2 ms (median of 12 runs; p99 2.6 ms), and an echo through a plain
//! socket 0.04 ms (p99 0.59 ms). The Manager then uses a whole core, so the kernel does not wake it before others, as
//! it does with the echo. The systemd units of the system therefore raise its priority (`Nice=-10`): with that, the p99
//! of a DECLARE was 1.65 ms, and that of the echo 1.15 ms. A shorter time slice (`sched_setattr`) changed nothing that
//! 12 paired runs could show. Smaller first parts of a DECLARE would lower the p99 further, but a publisher would wait
//! for fewer of its links.

use std::{collections::HashMap, time::Duration};

/// Start-time fair queueing: of the sockets that wait, the one with the smallest start tag is served first.
///
/// A socket's start tag is its finish tag, but not less than the virtual time. Serving a socket adds the time
/// that this took to its finish tag. The virtual time is the start tag of the socket that was served last. A
/// socket that was idle is therefore served before all sockets that have used more than their share since,
/// and gains nothing from having been idle for longer.
#[derive(Debug, Default)]
pub(super) struct Shares {
    virtual_ns: u64,
    finish_ns: HashMap<u64, u64>,
}

impl Shares {
    /// The start tag of a socket, by its epoll token.
    pub(super) fn start_tag(&self, token: u64) -> u64 {
        let finish_ns = self.finish_ns.get(&token).copied();
        finish_ns.map_or(self.virtual_ns, |it| it.max(self.virtual_ns))
    }

    /// Charges a socket for the time that served it.
    pub(super) fn charge(&mut self, token: u64, time: Duration) {
        self.virtual_ns = self.start_tag(token);
        let time_ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let finish_ns = self.virtual_ns.saturating_add(time_ns);
        self.finish_ns.insert(token, finish_ns);
    }

    /// The socket is closed.
    pub(super) fn forget(&mut self, token: u64) {
        self.finish_ns.remove(&token);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIECE: Duration = Duration::from_nanos(100);

    /// The order in which sockets are served that all wait, with the time that each takes when it is served.
    fn served(shares: &mut Shares, sockets: &[(u64, u64)], times: usize) -> Vec<u64> {
        let mut serve = || {
            let next = sockets.iter().min_by_key(|it| shares.start_tag(it.0));
            let &(token, time_ns) = next.expect("a socket");
            shares.charge(token, Duration::from_nanos(time_ns));
            token
        };
        (0..times).map(|_| serve()).collect()
    }

    fn count(order: &[u64], token: u64) -> usize {
        order.iter().filter(|it| **it == token).count()
    }

    #[test]
    fn sockets_that_wait_get_the_same_time() {
        let mut shares = Shares::default();
        let order = served(&mut shares, &[(1, 100), (2, 50), (3, 100)], 400);
        assert_eq!([1, 2, 3].map(|it| count(&order, it)), [100, 200, 100]);
    }

    #[test]
    fn a_socket_that_was_idle_is_next() {
        let mut shares = Shares::default();
        shares.charge(9, PIECE);
        served(&mut shares, &[(1, 100), (2, 100), (3, 100)], 300);
        for idle in [9, 10] {
            let start = shares.start_tag(idle);
            assert!([1, 2, 3].iter().all(|it| start <= shares.start_tag(*it)));
        }
        // It has not saved up time: the others are served at once, too.
        let order = served(&mut shares, &[(1, 100), (2, 100), (3, 100), (9, 100)], 40);
        assert_eq!(count(&order, 9), 10);
    }

    #[test]
    fn a_closed_socket_leaves_nothing() {
        let mut shares = Shares::default();
        shares.charge(1, PIECE);
        shares.forget(1);
        assert!(shares.finish_ns.is_empty());
        assert_eq!(shares.start_tag(1), shares.start_tag(2));
    }
}
