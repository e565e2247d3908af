//! Rules and the QoS that belongs to them.

use sm2_proto::{
    Instant,
    gateway::{Direction, GatewayId, OfferId, Rules, Subject, schedule::SendQos},
};

/// The rules, and the QoS of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Policy {
    /// The rules: the names that go to each peer, and come from it.
    pub rules: Rules,
    /// How messages are sent that a rule allows, by the index of the rule.
    pub send_qos: Vec<SendQos>,
}

/// Other rules that are not announced completely.
#[derive(Debug)]
pub(super) struct Reload {
    /// The time when they came.
    pub(super) since: Instant,
    /// The offer that has got its QoS last.
    pub(super) after: Option<(GatewayId, OfferId)>,
}

impl Policy {
    /// How messages of this topic are sent to that peer.
    pub(super) fn send_qos(&self, subject: &Subject, peer: &GatewayId) -> SendQos {
        let decision = self
            .rules
            .decide(subject.kind(), subject.name(), Direction::Out, peer);
        let qos = decision.rule.and_then(|rule| self.send_qos.get(rule));
        qos.copied().unwrap_or(DEFAULT_SEND_QOS)
    }
}

/// How messages are sent if their rule states no QoS.
pub const DEFAULT_SEND_QOS: SendQos = SendQos {
    depth: 1,
    priority: 3,
    messages_per_s: None,
    bytes_per_s: None,
    max_age: None,
};
