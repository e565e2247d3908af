//! The handlers of the Manager's frames (the tables of SPEC sections 4.2 and 4.3).

#[cfg(any(kani, test))]
mod proofs;

use super::{
    End, Node, Output,
    interface::{Answer, Answered, Interface, Judged, Link},
    phase::Phase,
};
use crate::{
    Code, Datagram, Farewell, InterfaceId, LinkId, LinkQos, Refusal, Violation,
    control::{LinkPeer, ToManager, ToNode, decode_to_node},
};

impl Node {
    //= SM2-NOD-001
    pub(super) fn receive(&mut self, datagram: &Datagram<'_>) -> Result<(), End> {
        let step = decode_to_node(datagram).and_then(|frame| {
            let has_fds = !datagram.has_lost_fds(frame.fds());
            self.step(frame, has_fds)
        });
        step.map_err(|violation| {
            let code = violation.code();
            self.send(&ToManager::Goodbye { code });
            let end = End::Violation(violation);
            self.go_away(end);
            end
        })
    }

    /// Handles one frame in the phase of the session: the table of SPEC section 4.2. `has_fds` is
    /// false if this process lost the frame's descriptor.
    fn step(&mut self, frame: ToNode, has_fds: bool) -> Result<(), Violation> {
        match self.phase {
            Phase::Away(..) | Phase::Ended(_) => Ok(()),
            Phase::Greeting(_) | Phase::Refused(_) => self.answer_to_hello(frame),
            Phase::Resuming(_) | Phase::Ready(_) => self.frame_of_session(frame, has_fds),
        }
    }

    fn answer_to_hello(&mut self, frame: ToNode) -> Result<(), Violation> {
        match (&self.phase, frame) {
            (_, ToNode::Goodbye { code }) => self.go_away(End::Peer(code)),
            (
                Phase::Greeting(_),
                ToNode::Welcome {
                    version,
                    epoch,
                    node,
                },
            ) => self.welcome(version, epoch, node)?,
            (Phase::Greeting(_), ToNode::HelloRefused { reason }) => {
                self.phase = Phase::Refused(self.phase.take_known());
                self.emit(Output::HelloRefused(reason));
            }
            (_, ToNode::Welcome { .. } | ToNode::HelloRefused { .. }) => {
                return Err(violation!(UnexpectedWelcome, "SM2-NOD-001"));
            }
            _ => return Err(violation!(ExpectedWelcome, "SM2-NOD-001")),
        }
        Ok(())
    }

    fn frame_of_session(&mut self, frame: ToNode, has_fds: bool) -> Result<(), Violation> {
        let session = self.phase.session_mut();
        let session = session.ok_or(violation!(ExpectedWelcome, "SM2-NOD-001"))?;
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
                self.link(interface, link, (ours, has_fds), peer)?;
            }
            ToNode::Unlink {
                interface,
                link,
                code,
            } => self.unlink(interface, link, code)?,
            ToNode::Withdrawn { interface } => self.withdrawn(interface)?,
            ToNode::Page(page) => {
                session.requests.page()?;
                self.emit(Output::Page(page));
            }
            ToNode::Changes(changes) => {
                session.requests.changes()?;
                self.emit(Output::Changes(changes));
            }
            ToNode::Inspected { node } => {
                session.requests.inspected(node)?;
                //= SM2-TRN-011
                self.emit(match has_fds {
                    true => Output::Inspected { node },
                    false => Output::NotInspected { node },
                });
            }
            ToNode::NotInspected { node } => {
                session.requests.inspected(node)?;
                self.emit(Output::NotInspected { node });
            }
            ToNode::Described { data, text } => {
                session.requests.described(&data, text.as_deref())?;
                self.emit(Output::Described { data, text });
            }
            //= SM2-CNT-002
            ToNode::CountersLost => {
                session.requests.counters_lost()?;
                self.send_counters();
            }
            ToNode::Reloaded { outcome } => {
                session.requests.reloaded()?;
                self.emit(Output::Reloaded(outcome));
            }
        }
        Ok(())
    }

    fn declared(&mut self, interface: InterfaceId, matches: u32) -> Result<(), Violation> {
        if let Some(ours) = self.kept(interface) {
            if ours.allowed()? == Judged::Changed {
                self.emit(Output::Declared { interface, matches });
            }
            return Ok(());
        }
        match self.answered(interface)?.declared()? {
            Answered::First => self.emit(Output::Declared { interface, matches }),
            Answered::Renewed => {}
            Answered::WithdrawalQueued => self.send(&ToManager::Withdraw { interface }),
        }
        self.claim_when_answered();
        Ok(())
    }

    fn refused(&mut self, interface: InterfaceId, reason: Refusal) -> Result<(), Violation> {
        let is_denial = reason.is_denial();
        if let Some(ours) = self.kept(interface) {
            if ours.denied(is_denial)? == Judged::Changed {
                self.emit(Output::DeclareRefused { interface, reason });
                self.end_unclaimed(interface);
                // After the outputs that let the driver discard.
                //= SM2-ACC-014
                self.send(&ToManager::Suspended { interface });
            }
            return Ok(());
        }
        match self.answered(interface)?.refused(is_denial)? {
            Answered::First => {
                self.forget_interface(interface);
                self.emit(Output::DeclareRefused { interface, reason });
            }
            Answered::Renewed => {
                self.emit(Output::DeclareRefused { interface, reason });
                if is_denial {
                    self.end_unclaimed(interface);
                }
            }
            Answered::WithdrawalQueued if is_denial => {
                self.send(&ToManager::Withdraw { interface });
            }
            Answered::WithdrawalQueued => {
                self.forget_interface(interface);
                self.emit(Output::Withdrawn { interface });
            }
        }
        self.claim_when_answered();
        Ok(())
    }

    /// The interface, if the Manager has answered it in this session and keeps it.
    fn kept(&mut self, interface: InterfaceId) -> Option<&mut Interface> {
        self.interface(interface).filter(|it| it.is_kept())
    }

    /// Ends the links of a denied interface that this Manager does not know.
    //= SM2-RES-010, SM2-ACC-014
    fn end_unclaimed(&mut self, interface: InterfaceId) {
        let links = self.interface(interface).map(Interface::take_unclaimed);
        for link in links.into_iter().flatten() {
            let code = Farewell::Denied.code();
            self.emit(Output::Unlink {
                interface,
                link,
                code,
            });
        }
    }

    //= SM2-IFC-003
    fn withdrawn(&mut self, interface: InterfaceId) -> Result<(), Violation> {
        let ours = self.interface(interface);
        let ours = ours.ok_or(violation!(UnknownInterface, "SM2-IFC-003"))?;
        ours.withdrawn()?;
        self.forget_interface(interface);
        self.emit(Output::Withdrawn { interface });
        Ok(())
    }

    //= SM2-RES-002, SM2-FRM-004, SM2-TRN-011
    fn link(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        (ours, has_socket): (Link, bool),
        peer: LinkPeer,
    ) -> Result<(), Violation> {
        // The Manager links no interface of this node before CLAIMED.
        let asked = match &mut self.phase {
            Phase::Ready(session) => session.interfaces.by_id.get_mut(&interface),
            _ => None,
        };
        let asked = asked.ok_or(violation!(UnknownInterface, "SM2-LNK-004"))?;
        if !asked.link(link, ours, &peer)? {
            return Ok(());
        }
        if !has_socket {
            asked.close_link(link);
            let code = Farewell::Resources.code();
            self.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            });
            self.emit(Output::LinkLost {
                interface,
                link,
                peer,
            });
            return Ok(());
        }
        let Link { version, qos, .. } = ours;
        self.emit(Output::Linked {
            interface,
            link,
            version,
            qos,
            peer,
        });
        Ok(())
    }

    //= SM2-LNK-003
    fn unlink(
        &mut self,
        interface: InterfaceId,
        link: LinkId,
        code: Code,
    ) -> Result<(), Violation> {
        let ours = self.interface(interface);
        let ours = ours.ok_or(violation!(UnknownInterface, "SM2-LNK-003"))?;
        let answer = ours.unlink(link)?;
        // Messages of a link that has ended may still wait for the program. They are discarded before
        // the Manager gets the answer.
        //= SM2-ACC-014
        let is_denied = code == Farewell::Denied.code();
        if answer == Answer::Unlinked || (answer == Answer::Crossed && is_denied) {
            self.emit(Output::Unlink {
                interface,
                link,
                code,
            });
        }
        if answer == Answer::Unlinked {
            self.send(&ToManager::Unlinked {
                interface,
                link,
                code,
            });
        }
        Ok(())
    }

    /// The interface that the Manager answers, which has to be the first one without an answer.
    //= SM2-IFC-002, SM2-FRM-004
    fn answered(&mut self, interface: InterfaceId) -> Result<&mut Interface, Violation> {
        let unknown = violation!(UnknownInterface, "SM2-IFC-002");
        let session = self.phase.session_mut().ok_or(unknown)?;
        if session.declaring.front() != Some(&interface) {
            return Err(unknown);
        }
        session.declaring.pop_front();
        session.interfaces.by_id.get_mut(&interface).ok_or(unknown)
    }

    fn interface(&mut self, interface: InterfaceId) -> Option<&mut Interface> {
        self.phase.interfaces_mut()?.by_id.get_mut(&interface)
    }

    fn forget_interface(&mut self, interface: InterfaceId) {
        if let Some(interfaces) = self.phase.interfaces_mut() {
            interfaces.by_id.remove(&interface);
        }
    }

    fn emit(&mut self, output: Output) {
        self.outputs.push_back(output);
    }
}
