//! The commands of the hub, carried out.

use sm2_proto::gateway::session::{self, ControlCommand};

use super::{Command, Event, Peer, waiting_offers::WaitingOffer};
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
}
