//! The random events of a simulation.

use sm2_gateway::hub::LocalEvent;
use sm2_gateway::hub::RequestId;
use sm2_proto::{
    Instant,
    gateway::{Beacon, GatewayId, Subject, SubjectKind},
};

use super::{
    network::{Conditions, Datagram, MS},
    node::{Node, World},
    rules::RuleSet,
    script::{EPOCH, Place, Simulation},
};

impl Simulation {
    /// Executes one random event.
    pub(crate) fn op(&mut self) {
        let index = self.random.index(self.places.len());
        let subject = self.random.one_of(&self.subjects).clone();
        let dice = self.random.below(1_000);
        let present = self.random.percent(60);
        let Place::Here(node) = &mut self.places[index] else {
            return;
        };
        let events = match dice {
            0..500 => return self.publish_some(index),
            500..750 => return self.request(index),
            750..800 => return self.give_up(index),
            800..835 => node.domain.set_present(subject, present),
            835..880 if subject.kind() == SubjectKind::Topic => {
                let taken = present.then(|| 1 + (self.random.below(4) as u16));
                node.domain.set_taken(&subject, taken)
            }
            940..948 => return self.change_rules(index),
            948..953 => return self.cut(index),
            953..957 => return self.crash(index),
            957..965 => {
                self.world.network.conditions = Conditions::any(&mut self.random);
                return;
            }
            965..975 => return self.noise(index),
            _ => return,
        };
        let trace = &mut self.world.ledger.trace;
        trace.add(self.now, index, &format!("domain: {} events", events.len()));
        node.local(self.now, events);
    }

    /// Publishes a message of a random topic that the gateway subscribes to.
    fn publish_some(&mut self, index: usize) {
        let Place::Here(node) = &self.places[index] else {
            return;
        };
        let taken: Vec<Subject> = node.domain.subscribed.iter().cloned().collect();
        if !taken.is_empty() {
            let subject = self.random.one_of(&taken).clone();
            self.publish(index, &subject);
        }
    }

    pub(crate) fn publish(&mut self, index: usize, subject: &Subject) {
        let long = *self.random.one_of(&[0, 0, 0, 0, 0, 0, 0, 3_000, 40_000]);
        let Place::Here(node) = &mut self.places[index] else {
            return;
        };
        // The gateway receives only messages of topics that it subscribes to.
        if subject.kind() != SubjectKind::Topic || !node.domain.subscribed.contains(subject) {
            return;
        }
        let ledger = &mut self.world.ledger;
        let (number, payload) = ledger.publish(self.now, index, subject, long);
        let text = format!("publishes {} {number}", subject.name());
        ledger.trace.add(self.now, index, &text);
        let event = LocalEvent::Message {
            subject: subject.clone(),
            published_at: self.now,
            payload,
        };
        node.local(self.now, vec![event]);
    }

    /// Calls a random service that the gateway shows.
    fn request(&mut self, index: usize) {
        let Place::Here(node) = &mut self.places[index] else {
            return;
        };
        let is_service = |it: &&(Subject, GatewayId)| it.0.kind() == SubjectKind::Service;
        let services: Vec<_> = node
            .domain
            .shown
            .iter()
            .filter(is_service)
            .cloned()
            .collect();
        if services.is_empty() {
            return;
        }
        let (subject, origin) = self.random.one_of(&services).clone();
        let deadline = (self.random.percent(30)).then_some(Instant(self.now.0 + 500 * MS));
        ask(node, self.now, &subject, origin, deadline, &mut self.world);
    }

    fn give_up(&mut self, index: usize) {
        let open = self.world.ledger.open_requests(index);
        let Place::Here(node) = &mut self.places[index] else {
            return;
        };
        if !open.is_empty() {
            let request = *self.random.one_of(&open);
            // The reply may be in flight already; it is for a caller that has left.
            self.world.ledger.give_up(index, request);
            node.local(self.now, vec![LocalEvent::Dropped { request }]);
        }
    }

    fn change_rules(&mut self, index: usize) {
        let rules = RuleSet::any(&mut self.random, self.keys.len());
        if let Place::Here(node) = &mut self.places[index] {
            node.reload(self.now, rules);
        }
    }

    fn cut(&mut self, index: usize) {
        let other = *self.random.one_of(&self.known[index]);
        let pair = (index.min(other), index.max(other));
        let until = Instant(self.now.0 + (100 + self.random.below(9_000)) * MS);
        let text = format!("cut from {other}");
        self.world.ledger.trace.add(self.now, index, &text);
        if self.world.network.cut.insert(pair) {
            self.cuts.push((until, pair));
        }
    }

    fn crash(&mut self, index: usize) {
        let until = Instant(self.now.0 + self.random.below(4_000) * MS);
        if let Place::Here(node) = &self.places[index] {
            let nodes = node.domain.nodes.clone();
            self.places[index] = Place::Away { until, nodes };
            self.world.ledger.crashed(index);
            self.world.ledger.trace.add(self.now, index, "crashes");
        }
    }

    /// Delivers a datagram of random bytes, or a beacon with false contents.
    //= SM2-GWD-002 test
    fn noise(&mut self, index: usize) {
        let from = self.random.index(self.places.len());
        let is_beacon = self.random.percent(50);
        let mut bytes = self.random.bytes().repeat(1 + self.random.index(40));
        if is_beacon {
            let gateway = *self.random.one_of(&self.world.ledger.ids);
            let epoch = self.random.below(2 * EPOCH);
            let port = 7633;
            let beacon = Beacon {
                port,
                gateway,
                epoch,
            };
            bytes = beacon.to_bytes().to_vec();
        }
        let datagram = Datagram {
            from,
            to: index,
            bytes,
            is_beacon,
        };
        if let Place::Here(node) = &mut self.places[index] {
            node.datagram(self.now, &datagram, &mut self.world);
        }
    }
}

/// Calls a service that is shown to the domain.
pub(crate) fn ask(
    node: &mut Node,
    now: Instant,
    subject: &Subject,
    origin: GatewayId,
    deadline: Option<Instant>,
    world: &mut World,
) -> RequestId {
    node.domain.last_request.0 += 1;
    let request = node.domain.last_request;
    let at = world.ledger.index(origin);
    let payload = world.ledger.ask(now, node.index, request, subject, at);
    let text = format!("asks {}: {} of {at}", request.0, subject.name());
    world.ledger.trace.add(now, node.index, &text);
    let event = LocalEvent::Request {
        request,
        subject: subject.clone(),
        origin,
        deadline,
        payload,
    };
    node.local(now, vec![event]);
    request
}
