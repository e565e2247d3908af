//! The commands of the hub, carried out.

use std::sync::Arc;

use quinn_proto::StreamId;
use sm2_io::quic::peer_of;
use sm2_proto::gateway::{
    Rules,
    session::{self, ControlCommand},
};

use super::{Command, Event, Peer, gate::Gate, stream::token, waiting_offers::WaitingOffer};
use crate::clock::Now;

impl Peer {
    pub(super) fn command(&mut self, now: Now, command: Command) {
        match command {
            Command::Offer {
                offer,
                subject,
                path,
                qos,
            } => {
                let it = WaitingOffer { subject, path, qos };
                self.offer(now, offer, it);
            }
            Command::Control(command) => self.control_command(now, command),
            Command::Change { offer, qos } => self.change(now, offer, qos),
            Command::Message { offer, message } => {
                let (topics, mut outlet) = self.topics(now);
                topics.publish(&mut outlet, offer, message);
            }
            Command::Call {
                call,
                offer,
                deadline,
                payload,
            } => self.call(now, call, offer, deadline, payload),
            Command::Forget { call } => self.forget(now, call),
            Command::Reply {
                call,
                outcome,
                payload,
            } => self.reply(call, outcome, payload),
            Command::Rules(rules) => self.gate(now, rules),
            Command::Close(code) => {
                self.session_takes(now, session::Input::Close(code));
            }
        }
    }

    fn control_command(&mut self, now: Now, command: ControlCommand) {
        if let ControlCommand::Unoffer { offer } = command {
            return self.withdraw(now, offer);
        }
        let asked = match command {
            ControlCommand::Ask { ask, .. } => Some(ask),
            _ => None,
        };
        let taken = self.session_command(now, session::Command::Control(command));
        if let Some(ask) = asked.filter(|_| !taken) {
            self.events.push_back(Event::NotAsked { ask });
        }
    }

    /// Stops sending the messages and requests that the rules deny. Waiting messages are judged when they
    /// are about to start.
    //= SM2-GWR-004
    pub(super) fn gate(&mut self, now: Now, rules: Option<Arc<Rules>>) {
        let gate = rules.zip(peer_of(&self.connection));
        self.gate = gate.map(|(rules, peer)| Gate { rules, peer });
        let Some(gate) = &self.gate else { return };
        let denied: Vec<StreamId> = self
            .calls
            .requests_in_flight()
            .filter_map(|(offer, id)| gate.denies(&self.tally, offer).then_some(id))
            .collect();
        for id in denied {
            let stream = token(id);
            self.session_command(now, session::Command::Forget { stream });
            let call = self.abandon(id);
            self.events.extend(call.map(Event::unreachable));
        }
        let (topics, mut outlet) = self.topics(now);
        topics.reset_denied(&mut outlet);
    }
}
