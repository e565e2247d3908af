//! The oracle of the simulation. It records what was published, called and allowed at all gateways,
//! and checks every delivery and reply against that record.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use bytes::Bytes;
use sm2_gateway::hub::RequestId;
use sm2_proto::{
    Instant,
    gateway::{Direction, GatewayId, Hop, Outcome, Subject},
};

use super::rules::RuleSet;

const HOPS_MAX: usize = 8;
/// How many of the last events a failing test prints.
const TAIL: usize = 80;

/// The events of a run: a digest and the number of all of them, and the text of the last ones.
#[derive(Debug)]
pub(crate) struct Trace {
    digest: u64,
    pub(crate) count: u64,
    tail: VecDeque<String>,
}

impl Trace {
    pub(crate) fn add(&mut self, now: Instant, node: usize, what: &str) {
        let line = format!("{:>9.1} ms {node}: {what}", now.0 as f64 / 1e6);
        for byte in line.bytes() {
            self.digest = (self.digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        self.count += 1;
        self.tail.push_back(line);
        if self.tail.len() > TAIL {
            self.tail.pop_front();
        }
    }

    pub(crate) const fn digest(&self) -> u64 {
        self.digest
    }

    pub(crate) fn tail(&self) -> String {
        self.tail.iter().map(|it| format!("{it}\n")).collect()
    }
}

/// A call from a domain that has no reply yet.
#[derive(Clone, Debug)]
struct Asked {
    subject: Subject,
    origin: usize,
    at: Instant,
    /// True if the caller has given up. A reply may still be in flight.
    is_dropped: bool,
}

pub(crate) struct Ledger {
    pub(crate) ids: Vec<GatewayId>,
    /// Pairs of gateways that trust each other, in both orders.
    pub(crate) links: BTreeSet<(usize, usize)>,
    /// The rules of each gateway, with the time when they begin to apply.
    policies: Vec<Vec<(Instant, RuleSet)>>,
    numbers: BTreeMap<(usize, Subject), u64>,
    published: BTreeMap<(usize, Subject, u64), Instant>,
    /// The number of the last message that a domain received from an origin.
    taken: BTreeMap<(usize, Subject, usize), u64>,
    asked: BTreeMap<(usize, RequestId), Asked>,
    pub(crate) delivered: u64,
    pub(crate) answered: BTreeMap<u64, u64>,
    /// The outcome of each call that has ended.
    pub(crate) last_answers: BTreeMap<(usize, RequestId), Outcome>,
    pub(crate) trace: Trace,
}

impl Ledger {
    pub(crate) fn new(ids: Vec<GatewayId>, links: BTreeSet<(usize, usize)>) -> Self {
        Self {
            policies: vec![Vec::new(); ids.len()],
            ids,
            links,
            numbers: BTreeMap::new(),
            published: BTreeMap::new(),
            taken: BTreeMap::new(),
            asked: BTreeMap::new(),
            delivered: 0,
            answered: BTreeMap::new(),
            last_answers: BTreeMap::new(),
            trace: Trace {
                digest: 0xcbf2_9ce4_8422_2325,
                count: 0,
                tail: VecDeque::new(),
            },
        }
    }

    pub(crate) fn index(&self, id: GatewayId) -> usize {
        let found = self.ids.iter().position(|it| *it == id);
        found.unwrap_or_else(|| panic!("{id} is not a gateway"))
    }

    /// Records that these rules apply from now on.
    pub(crate) fn policy(&mut self, now: Instant, node: usize, rules: RuleSet) {
        self.policies[node].push((now, rules));
    }

    pub(crate) fn rules(&self, node: usize) -> &RuleSet {
        &self.policies[node].last().unwrap().1
    }

    /// Returns true if the rules of a gateway allowed the subject at any time since `since`.
    fn allowed(
        &self,
        since: Instant,
        node: usize,
        subject: &Subject,
        direction: Direction,
        peer: usize,
    ) -> bool {
        let all = &self.policies[node];
        let old = all.iter().rposition(|(at, _)| *at <= since).unwrap_or(0);
        let mut some = all[old..].iter();
        some.any(|(_, rules)| rules.allows(subject, direction, peer))
    }

    /// Returns true if rules have allowed a path from the domain of `origin` to that of `to` at any
    /// time since `since`.
    pub(crate) fn reaches(
        &self,
        since: Instant,
        subject: &Subject,
        origin: usize,
        to: usize,
    ) -> bool {
        self.is_way(since, subject, &mut vec![origin], to)
    }

    fn is_way(&self, since: Instant, subject: &Subject, path: &mut Vec<usize>, to: usize) -> bool {
        let at = *path.last().unwrap();
        for next in 0..self.ids.len() {
            let is_step = self.links.contains(&(at, next))
                && !path.contains(&next)
                && path.len() <= HOPS_MAX
                && self.allowed(since, at, subject, Direction::Out, next)
                && self.allowed(since, next, subject, Direction::In, at);
            if !is_step {
                continue;
            }
            path.push(next);
            if next == to || self.is_way(since, subject, path, to) {
                return true;
            }
            path.pop();
        }
        false
    }

    /// Returns the number and the payload of a domain's next message.
    pub(crate) fn publish(
        &mut self,
        now: Instant,
        node: usize,
        subject: &Subject,
        len: usize,
    ) -> (u64, Bytes) {
        let last = self.numbers.entry((node, subject.clone())).or_insert(0);
        *last += 1;
        let number = *last;
        self.published.insert((node, subject.clone(), number), now);
        let text = format!("{node} {number} {} {:len$}", subject.name(), "");
        (number, text.into())
    }

    /// Checks a message that a gateway publishes in its domain.
    //= SM2-GWM-007 test
    //= SM2-GWM-008 test
    //= SM2-GWR-003 test
    //= SM2-GWR-004 test
    pub(crate) fn delivered(
        &mut self,
        node: usize,
        subject: &Subject,
        origin: GatewayId,
        payload: &[u8],
    ) {
        let (origin_said, number, name) = parse(payload);
        let origin = self.index(origin);
        assert_eq!(origin, origin_said, "a message of another origin");
        assert_eq!(name, subject.name().as_str(), "a message of another topic");
        assert_ne!(origin, node, "a message came back to its origin");
        let since = self.published.get(&(origin, subject.clone(), number));
        let since = *since.expect("a message that nobody published");
        assert!(
            self.reaches(since, subject, origin, node),
            "{subject:?} of {origin} came to {node} where no rules let it"
        );
        let may_come = (0..self.ids.len()).any(|peer| {
            self.links.contains(&(peer, node))
                && self.rules(node).allows(subject, Direction::In, peer)
        });
        assert!(may_come, "{subject:?} of {origin} is denied at {node} now");
        let last = self.taken.entry((node, subject.clone(), origin));
        let last = last.or_insert(0);
        assert!(
            *last < number,
            "{number} of {subject:?} of {origin} came after {last} to {node}"
        );
        *last = number;
        self.delivered += 1;
    }

    /// Checks a message that a gateway sends to a peer.
    //= SM2-GWO-003 test
    //= SM2-GWR-003 test
    pub(crate) fn forwarded(
        &self,
        node: usize,
        to: usize,
        subject: &Subject,
        path: &[Hop],
        payload: &[u8],
    ) {
        let (origin, _, name) = parse(payload);
        assert_eq!(name, subject.name().as_str(), "a message of another topic");
        assert_eq!(path[0].gateway, self.ids[origin], "of another origin");
        let is_back = path.iter().any(|it| it.gateway == self.ids[to]);
        assert!(!is_back, "{node} sends {subject:?} back to {to}");
        assert!(
            self.rules(node).allows(subject, Direction::Out, to),
            "{node} sends {subject:?} to {to}, which its rules deny"
        );
    }

    pub(crate) fn number_taken(&self, node: usize, subject: &Subject, origin: usize) -> u64 {
        let found = self.taken.get(&(node, subject.clone(), origin));
        found.copied().unwrap_or(0)
    }

    pub(crate) fn last_number(&self, node: usize, subject: &Subject) -> u64 {
        let found = self.numbers.get(&(node, subject.clone()));
        found.copied().unwrap_or(0)
    }

    /// Records a call from a domain. Returns its payload.
    pub(crate) fn ask(
        &mut self,
        now: Instant,
        node: usize,
        request: RequestId,
        subject: &Subject,
        origin: usize,
    ) -> Bytes {
        let it = Asked {
            subject: subject.clone(),
            origin,
            at: now,
            is_dropped: false,
        };
        self.asked.insert((node, request), it);
        format!("{node} {} {}", request.0, subject.name()).into()
    }

    /// Checks a call that reaches a server.
    pub(crate) fn called(&self, node: usize, subject: &Subject, payload: &[u8]) {
        let (from, request, name) = parse(payload);
        assert_eq!(name, subject.name().as_str(), "a call of another service");
        // A call that was dropped may still reach the server, and has no entry then.
        if let Some(it) = self.asked.get(&(from, RequestId(request))) {
            assert_eq!((node, subject), (it.origin, &it.subject), "another server");
            assert!(
                self.reaches(it.at, subject, node, from),
                "{from} calls {subject:?} of {node}, which no rules let it"
            );
        }
    }

    /// Checks the reply to a call.
    //= SM2-GWS-002 test
    pub(crate) fn replied(
        &mut self,
        node: usize,
        request: RequestId,
        outcome: Outcome,
        payload: &[u8],
    ) {
        let it = self.asked.remove(&(node, request));
        let it = it.expect("a reply to what was not asked, or replied to already");
        match outcome {
            Outcome::Ok => {
                let expected = format!("{} {node} {} {}", it.origin, request.0, it.subject.name());
                assert_eq!(payload, expected.as_bytes(), "another's reply");
            }
            _ => assert!(payload.is_empty(), "{outcome:?} with a payload"),
        }
        *self.answered.entry(outcome as u64).or_insert(0) += 1;
        self.last_answers.insert((node, request), outcome);
    }

    /// Records that the caller no longer wants the reply.
    pub(crate) fn give_up(&mut self, node: usize, request: RequestId) {
        if let Some(it) = self.asked.get_mut(&(node, request)) {
            it.is_dropped = true;
        }
    }

    pub(crate) fn open_requests(&self, node: usize) -> Vec<RequestId> {
        let is_open = |((of, _), it): &(&(usize, RequestId), &Asked)| *of == node && !it.is_dropped;
        let all = self.asked.iter().filter(is_open);
        all.map(|((_, request), _)| *request).collect()
    }

    /// Forgets the state that a crashed gateway has lost.
    pub(crate) fn crashed(&mut self, node: usize) {
        self.taken.retain(|(of, ..), _| *of != node);
        self.asked.retain(|(of, _), _| *of != node);
    }
}

/// Parses the origin or caller, the number and the name from a payload.
fn parse(payload: &[u8]) -> (usize, u64, &str) {
    let text = std::str::from_utf8(payload).unwrap();
    let mut words = text.split_whitespace();
    let mut next = || words.next().unwrap_or_else(|| panic!("{text:?}"));
    let (who, number) = (next().parse().unwrap(), next().parse().unwrap());
    (who, number, next())
}
