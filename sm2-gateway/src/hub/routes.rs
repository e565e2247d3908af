//! The outputs of the router, carried out.

use sm2_proto::{
    Instant, Machine,
    gateway::{
        GatewayId, OfferId, Subject, SubjectKind,
        router::{self, Source},
        session::ControlCommand,
    },
};

use super::{Hub, LocalCommand, Output, shares::Change};
use crate::{peer::Command, tally::Whose};

impl Hub {
    /// Feeds the router, and carries out its outputs.
    pub(super) fn route(&mut self, now: Instant, input: router::Input) {
        let Ok(()) = self.router.handle(now, input);
        while let Some(output) = self.router.poll() {
            self.routed(now, output);
        }
    }

    /// Applies the current rules and connections to a source that is about to be used, if the router has not come
    /// to the source yet.
    //= SM2-GWR-004
    pub(super) fn update_route(&mut self, now: Instant, subject: &Subject, source: Source) {
        if self.router.deadline().is_some() {
            let subject = subject.clone();
            self.route(now, router::Input::Use { subject, source });
        }
    }

    fn routed(&mut self, now: Instant, output: router::Output) {
        match output {
            router::Output::Offer {
                peer,
                offer,
                subject,
                path,
            } => {
                let qos = self.policy.send_qos(&subject, &peer);
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.tally.open(Whose::Ours(offer), &subject);
                    it.offered.insert(offer, subject.clone());
                }
                let command = Command::Offer {
                    offer,
                    subject,
                    path,
                    qos,
                };
                self.tell(peer, command);
            }
            router::Output::Unoffer { peer, offer } => {
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.tally.close(Whose::Ours(offer));
                    it.offered.remove(&offer);
                }
                self.control(peer, ControlCommand::Unoffer { offer });
            }
            router::Output::Want { peer, offer, depth } => {
                let offers = self.peers.get(&peer).map(|it| &it.offers);
                if let Some((subject, origin)) = offers.and_then(|it| it.get(&offer)) {
                    self.sequences.wanted(subject, origin.gateway);
                    let key = (subject.clone(), origin.gateway);
                    self.routes.insert(key, (peer, offer));
                }
                self.control(peer, ControlCommand::Want { offer, depth });
            }
            router::Output::Unwant { peer, offer } => self.unwant(peer, offer),
            router::Output::DeclareProxy {
                subject,
                origin,
                peer,
            } => self.declare_proxy(now, subject, origin, peer),
            router::Output::WithdrawProxy { subject, origin } => {
                self.routes.remove(&(subject.clone(), origin));
                self.unused(&subject, origin);
                let command = LocalCommand::WithdrawProxy { subject, origin };
                self.outputs.push_back(Output::Local(command));
            }
            // The domain's side takes each message, whatever depth the peers want.
            router::Output::Subscribe { subject, .. } => {
                self.shares.want(subject);
                self.share();
            }
            router::Output::Unsubscribe { subject } => {
                self.shares.unwant(&subject);
                self.share();
            }
        }
    }

    /// Carries out what the shares of the domain's processes decide.
    pub(super) fn share(&mut self) {
        while let Some(change) = self.shares.poll() {
            let output = match change {
                Change::Take(subject) => Output::Local(LocalCommand::Subscribe { subject }),
                Change::GiveUp(subject) => {
                    self.latched.forget(&subject, Source::Local);
                    Output::Local(LocalCommand::Unsubscribe { subject })
                }
                Change::Wait(subject) => Output::Waits { subject },
            };
            self.outputs.push_back(output);
        }
    }

    fn unwant(&mut self, peer: GatewayId, offer: OfferId) {
        let offers = self.peers.get(&peer).map(|it| &it.offers);
        if let Some((subject, origin)) = offers.and_then(|it| it.get(&offer)).cloned() {
            let key = (subject, origin.gateway);
            if self.routes.get(&key) == Some(&(peer, offer)) {
                self.unused(&key.0, key.1);
                self.routes.remove(&key);
            }
        }
        self.control(peer, ControlCommand::Unwant { offer });
    }

    fn declare_proxy(
        &mut self,
        now: Instant,
        subject: Subject,
        origin: GatewayId,
        peer: GatewayId,
    ) {
        let Some(it) = self.peers.get(&peer) else {
            return;
        };
        let command = LocalCommand::DeclareProxy {
            subject: subject.clone(),
            origin,
            peer: it.name.clone(),
        };
        self.outputs.push_back(Output::Local(command));
        // A service is wanted at once, so that the first call need not wait for the route.
        if subject.kind() == SubjectKind::Service {
            let taken = Some(1);
            let input = router::Input::Taken {
                subject,
                origin,
                taken,
            };
            let Ok(()) = self.router.handle(now, input);
        }
    }
}
