//! The accounts of links: each end's counts, as lines of text or from a counter file, and the differences
//! between the ends.

use std::collections::HashMap;

use sm2_node::diagnostics::{Counters, LinkStatus};
use sm2_proto::{Contract, LinkId, Name, counters::Entry};

/// The text of the end of a service's link with a gateway, whose counter file does not tell requests from
/// replies.
pub(crate) const GATEWAY_SERVICE: &str = "gateway-service";

/// Whether a node belongs to a gateway.
pub(crate) fn is_of_gateway(node: &Name) -> bool {
    sm2_gateway::is_remote(node) || node.as_str().starts_with("gateway/")
}

/// One end's counts of one link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct End {
    link: String,
    offered: u64,
    delivered: u64,
    /// Lost for the other end: displaced, or not sent before a deadline.
    dropped: u64,
    closed: u64,
    in_flight: u64,
    received: u64,
    lost: u64,
}

/// Messages of a sender without a counted fate, or with two.
pub(crate) fn unbalanced(counters: &Counters) -> u64 {
    let settled = counters.delivered + counters.dropped() + counters.in_flight;
    counters.offered.abs_diff(settled)
}

impl End {
    /// The counts of an open link, as words that [`parse`](Self::parse) reads.
    pub(crate) fn text(status: &LinkStatus) -> String {
        let LinkStatus {
            id,
            peer,
            counters: it,
            received,
            ..
        } = status;
        let is_service = matches!(
            peer.contract,
            Contract::Server { .. } | Contract::Client { .. }
        );
        if is_service && is_of_gateway(&peer.name) {
            return GATEWAY_SERVICE.to_owned();
        }
        format!(
            "{},{},{},{},{},{},{},{}",
            link_text(*id),
            it.offered,
            it.delivered,
            it.dropped() - it.closed,
            it.closed,
            it.in_flight,
            received.messages,
            received.lost
        )
    }

    /// The counts of the end of a topic's link in a counter file. `None` for other entries.
    pub(crate) fn of_entry(entry: &Entry, contract: &Contract) -> Option<Self> {
        let it = &entry.fates;
        // A publisher's file counts the messages that it sent in the same place.
        let received = match contract {
            Contract::Publisher { .. } => 0,
            Contract::Subscriber { .. } => entry.messages,
            Contract::Server { .. } | Contract::Client { .. } => return None,
        };
        Some(Self {
            link: link_text(entry.link?),
            offered: it.offered,
            // A node notices that a message was released when it publishes the next one.
            delivered: it.delivered + it.in_flight,
            dropped: it.dropped() - it.closed,
            closed: it.closed,
            in_flight: 0,
            received,
            lost: entry.lost,
        })
    }

    /// Reads the words of one end. `None` if they are damaged.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (link, numbers) = text.split_once(',')?;
        let numbers: Result<Vec<u64>, _> = numbers.split(',').map(str::parse).collect();
        let [
            offered,
            delivered,
            dropped,
            closed,
            in_flight,
            received,
            lost,
        ] = numbers.ok()?[..]
        else {
            return None;
        };
        Some(Self {
            link: link.to_owned(),
            offered,
            delivered,
            dropped,
            closed,
            in_flight,
            received,
            lost,
        })
    }

    /// Messages of this end that the other end does not account for, while nothing is sent.
    const fn unaccounted(&self, other: &Self) -> u64 {
        let settled = self.delivered + self.dropped + self.closed + self.in_flight;
        self.offered.abs_diff(settled)
            + self.in_flight
            + self.delivered.abs_diff(other.received)
            + self.dropped.abs_diff(other.lost)
    }
}

fn link_text(id: LinkId) -> String {
    format!("{:x}.{}", id.epoch, id.serial)
}

/// The messages that the ends of all links, with the names of their processes, do not account for,
/// and a line for each such link. The domain must be at rest.
pub(crate) fn unaccounted(ends: &[(String, End)]) -> (u64, Vec<String>) {
    let mut links: HashMap<&str, Vec<(&str, &End)>> = HashMap::new();
    for (name, end) in ends {
        links.entry(&end.link).or_default().push((name, end));
    }
    let mut lines = Vec::new();
    let mut sum = 0;
    for ends in links.values() {
        let missing = match ends[..] {
            [(_, one), (_, other)] => one.unaccounted(other) + other.unaccounted(one),
            _ => 1,
        };
        if missing > 0 {
            sum += missing;
            lines.push(format!("{missing} unaccounted: {ends:?}"));
        }
    }
    (sum, lines)
}

#[cfg(test)]
mod tests {
    use super::{End, unaccounted};

    fn ends(sender: &str, receiver: &str) -> u64 {
        let end = |name: &str, text| (name.to_owned(), End::parse(text).expect("an end"));
        unaccounted(&[end("sender", sender), end("receiver", receiver)]).0
    }

    #[test]
    fn every_count_matters() {
        let receiver = "a.1,0,0,0,0,0,7,2";
        assert_eq!(ends("a.1,9,7,2,0,0,0,0", receiver), 0);
        assert_eq!(ends("a.1,10,7,2,0,0,0,0", receiver), 1, "offered");
        assert_eq!(ends("a.1,10,8,2,0,0,0,0", receiver), 1, "delivered");
        assert_eq!(ends("a.1,11,7,4,0,0,0,0", receiver), 2, "dropped");
        assert_eq!(ends("a.1,10,7,2,0,1,0,0", receiver), 1, "in flight");
        assert_eq!(ends("a.2,9,7,2,0,0,0,0", receiver), 2, "another link");
        assert_eq!(End::parse("a.1,1,2"), None);
    }
}
