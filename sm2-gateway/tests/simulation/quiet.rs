//! The checks after a time without events.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::gateway::{Outcome, SubjectKind, session::Initiator};

use super::{
    domain::process,
    ops::ask,
    script::{SHORT_OF, Simulation},
};

impl Simulation {
    /// Runs all checks.
    pub(crate) fn check_quiet(&mut self) {
        self.check_connected();
        self.check_shown();
        self.check_shares();
        self.check_messages();
        self.check_calls();
        self.run(3_000);
        self.check_connected();
        self.check_nothing_left();
    }

    //= SM2-GWC-004 test
    fn check_connected(&mut self) {
        let count = self.world.ledger.ids.len();
        let links = self.world.ledger.links.clone();
        let ids = self.world.ledger.ids.clone();
        for node in self.nodes() {
            let mut peers: Vec<_> = node.hub.peers().iter().map(|it| it.id).collect();
            let known = (0..count).filter(|it| links.contains(&(node.index, *it)));
            let mut known: Vec<_> = known.map(|it| ids[it]).collect();
            peers.sort();
            known.sort();
            assert_eq!(peers, known, "{} is not connected with all", node.index);
            let open = node.open_peers().len();
            assert_eq!(open, known.len(), "{} has connections too many", node.index);
        }
    }

    /// A domain shows exactly the reachable subjects, and a gateway subscribes exactly to those
    /// that another domain wants.
    //= SM2-GWO-004 test
    //= SM2-GWR-003 test
    fn check_shown(&mut self) {
        let (now, subjects) = (self.now, self.subjects.clone());
        let count = self.world.ledger.ids.len();
        let (mut present, mut shown, mut takes, mut subscribed) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut waiting = Vec::new();
        for node in self.nodes() {
            present.push(node.domain.nodes.present.clone());
            shown.push(node.domain.shown.clone());
            takes.push(node.domain.nodes.takes.clone());
            subscribed.push(node.domain.subscribed.clone());
            waiting.push(node.hub.waiting().cloned().collect::<BTreeSet<_>>());
        }
        let ledger = &self.world.ledger;
        for subject in &subjects {
            for origin in 0..count {
                let mut is_taken = false;
                for to in (0..count).filter(|it| *it != origin) {
                    let reaches = present[origin].contains(subject)
                        && ledger.reaches(now, subject, origin, to);
                    let is_shown = shown[to].contains(&(subject.clone(), ledger.ids[origin]));
                    assert_eq!(is_shown, reaches, "{subject:?} of {origin} at {to}");
                    let is_wanted =
                        subject.kind() == SubjectKind::Service || takes[to].contains_key(subject);
                    is_taken |= reaches && is_wanted;
                }
                let is_subscribed = subscribed[origin].contains(subject);
                let is_subscribed = is_subscribed || waiting[origin].contains(subject);
                assert_eq!(is_subscribed, is_taken, "{subject:?} taken at {origin}");
            }
        }
    }

    /// A gateway lets a subject wait only if it has no descriptors for it, and if no other process has more.
    fn check_shares(&mut self) {
        for node in self.nodes() {
            let subscribed = &node.domain.subscribed;
            let mut of_process = BTreeMap::<_, u64>::new();
            for subject in subscribed {
                *of_process.entry(process(subject)).or_default() += 1;
            }
            let most = of_process.values().copied().max().unwrap_or(0);
            for subject in node.hub.waiting() {
                assert!(!subscribed.contains(subject));
                assert_eq!(subscribed.len() as u64, SHORT_OF, "{subject:?} waits");
                let own = of_process.get(&process(subject)).copied().unwrap_or(0);
                assert!(own + 1 >= most, "{subject:?} of {subscribed:?}");
            }
        }
    }

    /// A message published now arrives in every domain that wants it and can be reached.
    fn check_messages(&mut self) {
        let count = self.world.ledger.ids.len();
        for subject in self.subjects.clone() {
            for origin in 0..count {
                let mut takers = Vec::new();
                let mut number = None;
                for node in self.nodes() {
                    let domain = &node.domain;
                    if node.index == origin {
                        number = domain.subscribed.contains(&subject).then_some(());
                    } else if domain.nodes.takes.contains_key(&subject) {
                        takers.push(node.index);
                    }
                }
                if number.is_none() || subject.kind() != SubjectKind::Topic {
                    continue;
                }
                self.publish(origin, &subject);
                self.run(300);
                let ledger = &self.world.ledger;
                let number = ledger.last_number(origin, &subject);
                for to in takers {
                    if ledger.reaches(self.now, &subject, origin, to) {
                        let taken = ledger.number_taken(to, &subject, origin);
                        assert_eq!(taken, number, "{subject:?} of {origin} at {to}");
                    }
                }
            }
        }
    }

    /// A call to every service that is shown succeeds.
    //= SM2-GWS-001 test
    fn check_calls(&mut self) {
        let now = self.now;
        let mut asked = Vec::new();
        let mut nodes: Vec<usize> = Vec::new();
        nodes.extend(self.nodes().map(|it| it.index));
        for index in nodes {
            let (node, world) = self.node_and_world(index);
            let open = world.ledger.open_requests(index);
            assert!(open.is_empty(), "{open:?} of {index} have no reply");
            for (subject, origin) in node.domain.shown.clone() {
                if subject.kind() == SubjectKind::Service {
                    let request = ask(node, now, &subject, origin, None, world);
                    asked.push((index, request));
                }
            }
        }
        self.run(2_000);
        for it in asked {
            let outcome = self.world.ledger.last_answers.get(&it);
            assert_eq!(outcome, Some(&Outcome::Ok), "{it:?}");
        }
    }

    /// Every stream and every call has ended.
    fn check_nothing_left(&mut self) {
        for node in self.nodes() {
            let index = node.index;
            assert!(!node.domain.is_serving(), "{index} serves somebody");
            assert_eq!(node.hub.open_calls(), 0, "calls at {index}");
            for peer in node.open_peers() {
                let control = u64::from(peer.initiator() == Initiator::Peer);
                let usage = peer.usage();
                let streams = (usage.bidirectional_streams, usage.unidirectional_streams);
                assert_eq!(
                    (usage.payloads, usage.calls),
                    (0, 0),
                    "{usage:?} at {index}"
                );
                assert_eq!(streams, (control, 0), "{usage:?} at {index}");
            }
        }
    }
}
