//! A simplified model of a domain's nodes: publishers, subscribers, servers and clients.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use sm2_gateway::{
    hub::{LocalCommand, LocalEvent, Process, RequestId},
    peer::CallId,
};
use sm2_proto::{
    Instant,
    gateway::{GatewayId, Outcome, Subject, SubjectKind},
};

use super::{ledger::Ledger, network::MS, random::Random};

/// The nodes of a domain, which outlive a crash of the gateway.
#[derive(Clone, Debug, Default)]
pub(crate) struct Nodes {
    /// Subjects that have publishers or servers.
    pub(crate) present: BTreeSet<Subject>,
    /// Topics that have subscribers, with the depth of the subscribers' queue.
    pub(crate) takes: BTreeMap<Subject, u16>,
}

/// A domain as its gateway sees it.
pub(crate) struct Domain {
    me: usize,
    pub(crate) nodes: Nodes,
    pub(crate) shown: BTreeSet<(Subject, GatewayId)>,
    /// Subjects that the gateway subscribes to.
    pub(crate) subscribed: BTreeSet<Subject>,
    /// Calls in progress at local servers: when each is done, and its reply.
    serving: BTreeMap<CallId, (Instant, Bytes)>,
    pub(crate) last_request: RequestId,
    random: Random,
}

impl Domain {
    /// Returns the domain, and the first events for its gateway.
    pub(crate) fn new(me: usize, nodes: Nodes, random: Random) -> (Self, Vec<LocalEvent>) {
        let present = |subject: &Subject| presence(subject, true);
        let events = nodes.present.iter().flat_map(present).collect();
        let domain = Self {
            me,
            nodes,
            shown: BTreeSet::new(),
            subscribed: BTreeSet::new(),
            serving: BTreeMap::new(),
            last_request: RequestId::default(),
            random,
        };
        (domain, events)
    }

    /// Adds the first publisher or server of a subject, or removes the last one.
    pub(crate) fn set_present(&mut self, subject: Subject, present: bool) -> Vec<LocalEvent> {
        match present {
            true => self.nodes.present.insert(subject.clone()),
            false => self.nodes.present.remove(&subject),
        };
        presence(&subject, present).into()
    }

    /// Adds the first subscriber of a topic, or removes the last one.
    pub(crate) fn set_taken(&mut self, subject: &Subject, taken: Option<u16>) -> Vec<LocalEvent> {
        match taken {
            Some(depth) => self.nodes.takes.insert(subject.clone(), depth),
            None => self.nodes.takes.remove(subject),
        };
        let of_it = self.shown.iter().filter(|(it, _)| it == subject);
        of_it
            .map(|(_, origin)| taken_event(subject, *origin, taken))
            .collect()
    }

    /// Executes a command of the gateway. Returns the resulting events for the gateway.
    pub(crate) fn command(
        &mut self,
        now: Instant,
        command: LocalCommand,
        ledger: &mut Ledger,
    ) -> Vec<LocalEvent> {
        match command {
            LocalCommand::Subscribe { subject } => {
                assert!(self.subscribed.insert(subject), "it is subscribed");
            }
            LocalCommand::Unsubscribe { subject } => {
                assert!(self.subscribed.remove(&subject), "it was not subscribed");
            }
            LocalCommand::DeclareProxy {
                subject, origin, ..
            } => {
                let taken = self.nodes.takes.get(&subject).copied();
                let is_new = self.shown.insert((subject.clone(), origin));
                assert!(is_new, "{subject:?} is shown twice");
                if taken.is_some() {
                    return vec![taken_event(&subject, origin, taken)];
                }
            }
            LocalCommand::WithdrawProxy { subject, origin } => {
                let was_shown = self.shown.remove(&(subject.clone(), origin));
                assert!(was_shown, "{subject:?} was not shown");
                if subject.kind() == SubjectKind::Topic {
                    return vec![taken_event(&subject, origin, None)];
                }
            }
            LocalCommand::Publish {
                subject,
                origin,
                payload,
            } => {
                let is_shown = self.shown.contains(&(subject.clone(), origin));
                assert!(is_shown, "a message of {subject:?}, which is not shown");
                ledger.delivered(self.me, &subject, origin, &payload);
            }
            LocalCommand::Call {
                call,
                subject,
                payload,
                ..
            } => {
                ledger.called(self.me, &subject, &payload);
                let reply = [format!("{} ", self.me).as_bytes(), &payload].concat();
                let late = self.random.below(300) * MS;
                let due = Instant(now.0 + late);
                self.serving.insert(call, (due, reply.into()));
            }
            LocalCommand::Cancel { call } => {
                self.serving.remove(&call);
            }
            LocalCommand::Reply {
                request,
                outcome,
                payload,
            } => ledger.replied(self.me, request, outcome, &payload),
        }
        Vec::new()
    }

    pub(crate) fn waits(&self, subject: &Subject) {
        assert!(!self.subscribed.contains(subject), "it is subscribed");
    }

    pub(crate) fn deadline(&self) -> Option<Instant> {
        self.serving.values().map(|(due, _)| *due).min()
    }

    /// Returns a reply that is due, if there is one.
    pub(crate) fn poll(&mut self, now: Instant) -> Option<LocalEvent> {
        let due = self.serving.iter().find(|(_, (due, _))| *due <= now);
        let call = *due?.0;
        let (_, payload) = self.serving.remove(&call)?;
        let outcome = Outcome::Ok;
        Some(LocalEvent::Replied {
            call,
            outcome,
            payload,
        })
    }

    pub(crate) fn is_serving(&self) -> bool {
        !self.serving.is_empty()
    }
}

/// The process whose nodes have the publisher or server of a subject.
pub(crate) fn process(subject: &Subject) -> Process {
    let is_first = subject.name().as_str().starts_with("a/");
    let pid = if is_first { 1 } else { 2 };
    Process { uid: 0, pid }
}

fn presence(subject: &Subject, present: bool) -> [LocalEvent; 2] {
    let links = present.then(|| (process(subject), 1));
    let links = LocalEvent::Links {
        subject: subject.clone(),
        links: links.into_iter().collect(),
    };
    let subject = subject.clone();
    let event = LocalEvent::Present { subject, present };
    match present {
        true => [links, event],
        false => [event, links],
    }
}

fn taken_event(subject: &Subject, origin: GatewayId, taken: Option<u16>) -> LocalEvent {
    let subject = subject.clone();
    LocalEvent::Taken {
        subject,
        origin,
        taken,
    }
}
