//! The end of a session, and the resumption in the next one (SPEC section 11).

use super::{
    End, Error, Misuse, Node, Output,
    interface::Interface,
    phase::{Interfaces, OpenSession, Phase},
};
use crate::{Farewell, NodeId, VERSION, Violation, control::ToManager};

impl Node {
    /// There is a new connection: the node greets again.
    //= SM2-RES-001
    pub(super) fn reconnected(&mut self) -> Result<(), Error> {
        match self.phase {
            Phase::Away(..) | Phase::Refused(_) => {}
            Phase::Ended(end) => return Err(Error::Ended(end)),
            Phase::Greeting(_) | Phase::Resuming(_) | Phase::Ready(_) => {
                return Err(Misuse::Connected.into());
            }
        }
        self.greet();
        Ok(())
    }

    pub(super) fn greet(&mut self) {
        let known = self.phase.take_known();
        self.send(&ToManager::Hello {
            min_version: VERSION,
            max_version: VERSION,
            name: self.name.clone(),
            resuming: known.is_some(),
        });
        self.phase = Phase::Greeting(known);
    }

    /// WELCOME has come: the node declares its live interfaces again.
    //= SM2-NOD-002, SM2-RES-002, SM2-SES-006
    pub(super) fn welcome(
        &mut self,
        version: u16,
        epoch: u64,
        node: NodeId,
    ) -> Result<(), Violation> {
        if version != VERSION {
            return Err(violation!(BadVersion, "SM2-NOD-002"));
        }
        let known = self.phase.take_known();
        // Before the first DECLARE or CLAIM, so before this Manager makes any link.
        //= SM2-LNK-007
        if let Some(max_links) = self.max_links {
            self.send(&ToManager::MaxLinks { max_links });
        }
        self.outputs.push_back(Output::Welcomed {
            node,
            epoch,
            resuming: known.is_some(),
        });
        let Some(mut interfaces) = known else {
            self.phase = Phase::Ready(OpenSession::new(node, epoch, Interfaces::new()));
            return Ok(());
        };
        // The Manager sends no UNLINK for a link whose two ends are both of this node.
        for (interface, link) in interfaces.forget_links(epoch) {
            self.outputs.push_back(Output::Unlink {
                interface,
                link,
                code: Farewell::Done.code(),
            });
        }
        let mut session = OpenSession::new(node, epoch, interfaces);
        let declares = session.declare_all(Interface::renew);
        self.phase = Phase::Resuming(session);
        self.send_all(&declares);
        self.claim_when_answered();
        Ok(())
    }

    /// Once all repeated DECLAREs are answered, the node claims its open links and declares its
    /// new interfaces.
    //= SM2-RES-002
    pub(super) fn claim_when_answered(&mut self) {
        let mut session = match self.phase.take() {
            Phase::Resuming(session) if session.declaring.is_empty() => session,
            other => {
                self.phase = other;
                return;
            }
        };
        let links = session.interfaces.claim_links();
        let declares = session.declare_all(Interface::declare);
        self.phase = Phase::Ready(session);
        for (interface, id, link) in links {
            self.send(&ToManager::Claim {
                interface,
                link: id,
                key: link.key,
                version: link.version,
                reliable: link.qos.reliable,
                sealed: link.qos.sealed,
            });
        }
        self.send(&ToManager::Claimed);
        self.outputs.push_back(Output::Resumed);
        self.send_all(&declares);
    }

    /// The session is over, and the machine is not: interfaces and links stay.
    //= SM2-NOD-003, SM2-RES-001
    pub(super) fn go_away(&mut self, end: End) {
        let mut known = self.phase.take_known();
        let withdrawn = known.as_mut().map(Interfaces::end_session);
        for interface in withdrawn.into_iter().flatten() {
            self.outputs.push_back(Output::Withdrawn { interface });
        }
        self.phase = Phase::Away(end, known);
        self.outputs.push_back(Output::Ended(end));
    }

    /// The machine is over.
    pub(super) fn finish(&mut self, end: End) {
        self.phase = Phase::Ended(end);
        self.outputs.push_back(Output::Ended(end));
    }
}
