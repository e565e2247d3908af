//! From one session to the next (SPEC section 11).

use alloc::vec::Vec;

use super::{End, Error, Misuse, Node, Output, Phase, requests::Requests};
use crate::{Contract, Farewell, InterfaceId, NodeId, VERSION, Violation, control::ToManager};

impl Node {
    /// There is a new connection: the node greets again.
    //= SM2-RES-001
    pub(super) fn reconnected(&mut self) -> Result<(), Error> {
        match self.phase {
            Phase::Away(_) | Phase::Refused => {}
            Phase::Ended(end) => return Err(Error::Ended(end)),
            Phase::Greeting | Phase::Resuming(..) | Phase::Ready(..) => {
                return Err(Misuse::Connected.into());
            }
        }
        self.greet();
        Ok(())
    }

    pub(super) fn greet(&mut self) {
        self.phase = Phase::Greeting;
        self.send(&ToManager::Hello {
            min_version: VERSION,
            max_version: VERSION,
            name: self.name.clone(),
            resuming: self.welcomed,
        });
    }

    /// WELCOME came in: what was live is declared again.
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
        self.outputs.push_back(Output::Welcomed { node, epoch });
        if !self.welcomed {
            self.welcomed = true;
            self.phase = Phase::Ready(node, epoch);
            return Ok(());
        }
        self.phase = Phase::Resuming(node, epoch);
        let outputs = &mut self.outputs;
        let known = self.interfaces.iter_mut().filter_map(|(&interface, ours)| {
            // This Manager ended its links with our last session. Where both ends are
            // ours there is nobody else to say so.
            outputs.extend(ours.forget(epoch).map(|link| Output::Unlink {
                interface,
                link,
                code: Farewell::Done.code(),
            }));
            let contract = ours.renew()?.clone();
            Some((interface, contract))
        });
        let known: Vec<_> = known.collect();
        self.declare_all(known);
        self.claim_when_answered();
        Ok(())
    }

    /// When all that was declared again is answered, what is open is claimed,
    /// and what is new is declared.
    //= SM2-RES-002
    pub(super) fn claim_when_answered(&mut self) {
        let Phase::Resuming(node, epoch) = self.phase else {
            return;
        };
        if !self.declaring.is_empty() {
            return;
        }
        self.phase = Phase::Ready(node, epoch);
        let mut claims = Vec::new();
        for (&interface, ours) in &mut self.interfaces {
            claims.extend(ours.claim().map(|(id, link)| ToManager::Claim {
                interface,
                link: id,
                key: link.key,
                version: link.version,
                reliable: link.qos.reliable,
                sealed: link.qos.sealed,
            }));
        }
        for claim in claims {
            self.send(&claim);
        }
        self.send(&ToManager::Claimed);
        self.outputs.push_back(Output::Resumed);
        // What no Manager has answered yet.
        let queued = self.interfaces.iter_mut().filter_map(|(&interface, ours)| {
            let contract = ours.declare()?.clone();
            Some((interface, contract))
        });
        let queued: Vec<_> = queued.collect();
        self.declare_all(queued);
    }

    pub(super) fn declare_all(
        &mut self,
        interfaces: impl IntoIterator<Item = (InterfaceId, Contract)>,
    ) {
        for (interface, contract) in interfaces {
            self.declaring.push_back(interface);
            self.send(&ToManager::Declare {
                interface,
                contract,
            });
        }
    }

    /// The session is over, and the machine is not: interfaces and links stay.
    //= SM2-NOD-003, SM2-RES-001
    pub(super) fn go_away(&mut self, end: End) {
        self.phase = Phase::Away(end);
        self.declaring.clear();
        self.requests = Requests::default();
        let outputs = &mut self.outputs;
        self.interfaces.retain(|&interface, ours| {
            let stays = ours.away();
            if !stays {
                outputs.push_back(Output::Withdrawn { interface });
            }
            stays
        });
        self.outputs.push_back(Output::Ended(end));
    }

    /// The machine is over.
    pub(super) fn finish(&mut self, end: End) {
        self.phase = Phase::Ended(end);
        self.declaring.clear();
        self.requests = Requests::default();
        self.interfaces.clear();
        self.outputs.push_back(Output::Ended(end));
    }
}
