//! What the Manager says (the tables of SPEC sections 4.2 and 4.3).

#[cfg(any(kani, test))]
mod proofs;

use super::{
    End, Interface, Node, Output, Phase,
    interface::{Answer, Answered, Link},
};
use crate::{
    Code, Datagram, InterfaceId, LinkId, LinkQos, Refusal, Violation,
    control::{Peer, ToManager, ToNode, decode_to_node},
};

impl Node {
    //= SM2-NOD-001
    pub(super) fn receive(&mut self, datagram: &Datagram<'_>) -> Result<(), End> {
        let step = decode_to_node(datagram).and_then(|frame| self.step(frame));
        step.map_err(|violation| {
            let code = violation.code();
            self.send(&ToManager::Goodbye { code });
            let end = End::Violation(violation);
            self.go_away(end);
            end
        })
    }

    /// One frame in the session's phase: the table of SPEC section 4.2.
    fn step(&mut self, frame: ToNode) -> Result<(), Violation> {
        match self.phase {
            Phase::Away(_) | Phase::Ended(_) => Ok(()),
            Phase::Greeting | Phase::Refused => self.greeting(frame),
            Phase::Resuming(..) | Phase::Ready(..) => self.welcomed(frame),
        }
    }

    fn greeting(&mut self, frame: ToNode) -> Result<(), Violation> {
        match (self.phase, frame) {
            (_, ToNode::Goodbye { code }) => self.go_away(End::Peer(code)),
            (
                Phase::Greeting,
                ToNode::Welcome {
                    version,
                    epoch,
                    node,
                },
            ) => self.welcome(version, epoch, node)?,
            (Phase::Greeting, ToNode::HelloRefused { reason }) => {
                self.phase = Phase::Refused;
                self.tell(Output::HelloRefused(reason));
            }
            (_, ToNode::Welcome { .. } | ToNode::HelloRefused { .. }) => {
                return Err(violation!(UnexpectedWelcome, "SM2-NOD-001"));
            }
            _ => return Err(violation!(ExpectedWelcome, "SM2-NOD-001")),
        }
        Ok(())
    }

    fn welcomed(&mut self, frame: ToNode) -> Result<(), Violation> {
        match frame {
            ToNode::Welcome { .. } | ToNode::HelloRefused { .. } => {
                return Err(violation!(UnexpectedWelcome, "SM2-NOD-001"));
            }
            ToNode::Goodbye { code } => self.go_away(End::Peer(code)),
            ToNode::Declared { interface, matches } => self.declared(interface, matches)?,
            ToNode::DeclareRefused { interface, reason } => self.refused(interface, reason)?,
            ToNode::Link {
                interface,
                link,
                key,
                version,
                reliable,
                sealed,
                peer,
            } => {
                let qos = LinkQos { reliable, sealed };
                let ours = Link { key, version, qos };
                self.link(interface, link, ours, peer)?;
            }
            ToNode::Unlink {
                interface,
                link,
                code,
            } => self.unlink(interface, link, code)?,
            ToNode::Withdrawn { interface } => {
                let ours = self.interfaces.get(&interface);
                ours.ok_or(violation!(UnknownInterface, "SM2-IFC-003"))?
                    .withdrawn()?;
                self.interfaces.remove(&interface);
                self.tell(Output::Withdrawn { interface });
            }
            ToNode::Page {
                revision,
                items,
                next,
            } => {
                self.requests.page()?;
                self.tell(Output::Page {
                    revision,
                    items,
                    next,
                });
            }
            ToNode::Changes {
                revision,
                changes,
                more,
            } => {
                self.requests.changes()?;
                self.tell(Output::Changes {
                    revision,
                    changes,
                    more,
                });
            }
            ToNode::Inspected { node } => {
                self.requests.inspected(node)?;
                self.tell(Output::Inspected { node });
            }
            ToNode::NotInspected { node } => {
                self.requests.inspected(node)?;
                self.tell(Output::NotInspected { node });
            }
            ToNode::Described { data, text } => {
                self.requests.described(&data, text.as_deref())?;
                self.tell(Output::Described { data, text });
            }
        }
        Ok(())
    }

    fn declared(&mut self, interface: InterfaceId, matches: u32) -> Result<(), Violation> {
        match self.answered(interface)?.declared()? {
            Answered::First => self.tell(Output::Declared { interface, matches }),
            Answered::Renewed => {}
            Answered::Doomed => self.send(&ToManager::Withdraw { interface }),
        }
        self.claim_when_answered();
        Ok(())
    }

    fn refused(&mut self, interface: InterfaceId, reason: Refusal) -> Result<(), Violation> {
        match self.answered(interface)?.refused()? {
            Answered::First => {
                self.interfaces.remove(&interface);
                self.tell(Output::DeclareRefused { interface, reason });
            }
            Answered::Renewed => self.tell(Output::DeclareRefused { interface, reason }),
            Answered::Doomed => {
                self.interfaces.remove(&interface);
                self.tell(Output::Withdrawn { interface });
            }
        }
        self.claim_when_answered();
        Ok(())
    }

    //= SM2-RES-002, SM2-FRM-004
    fn link(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        ours: Link,
        peer: Peer,
    ) -> Result<(), Violation> {
        if let Phase::Resuming(..) = self.phase {
            // Nothing of ours is linked before CLAIMED.
            return Err(violation!(UnknownInterface, "SM2-LNK-005"));
        }
        let interfaces = &mut self.interfaces;
        let asked = interfaces
            .get_mut(&interface)
            .ok_or(violation!(UnknownInterface, "SM2-LNK-005"))?;
        if asked.link(link, ours, &peer)? {
            let Link { version, qos, .. } = ours;
            let LinkQos { reliable, sealed } = qos;
            self.tell(Output::Linked {
                interface,
                link,
                version,
                reliable,
                sealed,
                peer,
            });
        }
        Ok(())
    }

    //= SM2-LNK-003
    fn unlink(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        code: Code,
    ) -> Result<(), Violation> {
        let ours = self.interfaces.get_mut(&interface);
        let ours = ours.ok_or(violation!(UnknownInterface, "SM2-LNK-003"))?;
        if ours.unlink(link)? == Answer::Unlinked {
            self.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            });
            self.tell(Output::Unlink {
                interface,
                link,
                code,
            });
        }
        Ok(())
    }

    /// The interface that the Manager has to answer next.
    //= SM2-IFC-002, SM2-FRM-004
    fn answered(&mut self, interface: InterfaceId) -> Result<&mut Interface, Violation> {
        if self.declaring.front() != Some(&interface) {
            return Err(violation!(UnknownInterface, "SM2-IFC-002"));
        }
        self.declaring.pop_front();
        let ours = self.interfaces.get_mut(&interface);
        ours.ok_or(violation!(UnknownInterface, "SM2-IFC-002"))
    }

    fn tell(&mut self, output: Output) {
        self.outputs.push_back(output);
    }
}
