//! Calls on their way: who waits for which reply.

use std::collections::BTreeMap;

use bytes::Bytes;
use sm2_proto::{
    Instant,
    gateway::{GatewayId, OfferId, Outcome, Subject, SubjectKind, router::Source},
};

use super::{Hub, LocalCommand, Output, RequestId};

use crate::peer::{CallId, Command, ConnectionId, PeerCall};

/// The calls that have no reply yet.
#[derive(Debug, Default)]
pub(super) struct Calls {
    /// By which peer's offer each remote topic or service comes, if it is wanted.
    pub(super) routes: BTreeMap<(Subject, GatewayId), (GatewayId, OfferId)>,
    open: BTreeMap<CallId, Call>,
    last: CallId,
}

/// One call: who waits, and where it went.
#[derive(Clone, Copy, Debug)]
struct Call {
    from: Caller,
    /// The connection that it went out by; none: to a server of the domain.
    by: Option<ConnectionId>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Caller {
    Local {
        request: RequestId,
    },
    Peer {
        connection: ConnectionId,
        call: PeerCall,
    },
}

impl Calls {
    pub(super) fn open(&self) -> usize {
        self.open.len()
    }
}

impl Hub {
    /// Somebody in the domain calls a remote service.
    pub(super) fn local_request(
        &mut self,
        request: RequestId,
        subject: &Subject,
        origin: GatewayId,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        let from = Caller::Local { request };
        self.call_remote(from, subject, origin, deadline, payload);
    }

    /// A peer calls.
    //= SM2-GWS-001
    pub(super) fn request(
        &mut self,
        from: Caller,
        peer: GatewayId,
        offer: OfferId,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        match self.source(peer, offer) {
            Some((subject, Source::Local)) if subject.kind() == SubjectKind::Service => {
                let call = self.open_call(from, None);
                self.outputs.push_back(Output::Local(LocalCommand::Call {
                    call,
                    subject,
                    deadline,
                    payload,
                }));
            }
            Some((subject, Source::Remote(origin))) => {
                self.call_remote(from, &subject, origin, deadline, payload);
            }
            _ => self.answer(from, Outcome::Unreachable, Bytes::new()),
        }
    }

    fn call_remote(
        &mut self,
        from: Caller,
        subject: &Subject,
        origin: GatewayId,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        let route = self.calls.routes.get(&(subject.clone(), origin)).copied();
        let route = route.and_then(|(peer, offer)| {
            let by = self.peers.get(&peer)?.connection;
            Some((by, offer))
        });
        let Some((connection, offer)) = route else {
            return self.answer(from, Outcome::Unreachable, Bytes::new());
        };
        let call = self.open_call(from, Some(connection));
        let command = Command::Call {
            call,
            offer,
            deadline,
            payload,
        };
        self.outputs.push_back(Output::Peer {
            connection,
            command,
        });
    }

    fn open_call(&mut self, from: Caller, by: Option<ConnectionId>) -> CallId {
        self.calls.last.0 += 1;
        self.calls.open.insert(self.calls.last, Call { from, by });
        self.calls.last
    }

    /// Whoever was called has replied.
    pub(super) fn replied(&mut self, call: CallId, outcome: Outcome, payload: Bytes) {
        if let Some(call) = self.calls.open.remove(&call) {
            self.answer(call.from, outcome, payload);
        }
    }

    /// A peer does not want the reply any more.
    //= SM2-GWS-003
    pub(super) fn cancelled(&mut self, connection: ConnectionId, call: PeerCall) {
        self.drop_calls(|it| it == Caller::Peer { connection, call });
    }

    /// Nor does somebody in the domain.
    pub(super) fn local_dropped(&mut self, request: RequestId) {
        self.drop_calls(|it| it == Caller::Local { request });
    }

    /// The callers of a connection that is over are gone. What was called by it fails at once: its
    /// session has said so.
    //= SM2-GWS-002
    pub(super) fn calls_ended(&mut self, connection: ConnectionId) {
        self.drop_calls(|it| matches!(it, Caller::Peer { connection: of, .. } if of == connection));
        let lost = self.calls.open.iter();
        let lost = lost.filter(|(_, it)| it.by == Some(connection));
        let lost: Vec<CallId> = lost.map(|(id, _)| *id).collect();
        for call in lost {
            self.replied(call, Outcome::Unreachable, Bytes::new());
        }
    }

    fn drop_calls(&mut self, of: impl Fn(Caller) -> bool) {
        let outputs = &mut self.outputs;
        self.calls.open.retain(|&call, it| {
            if !of(it.from) {
                return true;
            }
            outputs.push_back(match it.by {
                Some(connection) => Output::Peer {
                    connection,
                    command: Command::Forget { call },
                },
                None => Output::Local(LocalCommand::Cancel { call }),
            });
            false
        });
    }

    fn answer(&mut self, caller: Caller, outcome: Outcome, payload: Bytes) {
        self.outputs.push_back(match caller {
            Caller::Local { request } => Output::Local(LocalCommand::Reply {
                request,
                outcome,
                payload,
            }),
            Caller::Peer { connection, call } => Output::Peer {
                connection,
                command: Command::Reply {
                    call,
                    outcome,
                    payload,
                },
            },
        });
    }
}
