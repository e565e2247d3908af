//! Calls: from whom, to whom, and the way back of the reply.

use bytes::Bytes;
use sm2_proto::{
    Instant,
    gateway::{GatewayId, OfferId, Outcome, Subject, SubjectKind, router::Source},
};

use super::{
    Hub, LocalCommand, Output, RequestId,
    open_calls::{Caller, OpenCall},
};
use crate::peer::{CallId, Command, ConnectionId, PeerCall};

impl Hub {
    /// A client of the domain calls a remote service.
    pub(super) fn local_request(
        &mut self,
        now: Instant,
        request: RequestId,
        (subject, origin): (&Subject, GatewayId),
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        self.update_route(now, subject, Source::Remote(origin));
        let caller = Caller::Local { request };
        self.call_remote(caller, subject, origin, deadline, payload);
    }

    /// A peer calls a service.
    //= SM2-GWS-001
    pub(super) fn request(
        &mut self,
        now: Instant,
        caller: Caller,
        (peer, offer): (GatewayId, OfferId),
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        if let Some((subject, source)) = self.source(peer, offer) {
            self.update_route(now, &subject, source);
        }
        match self.source(peer, offer) {
            Some((subject, Source::Local)) if subject.kind() == SubjectKind::Service => {
                let call = self.calls.add(caller, subject.clone(), None);
                self.outputs.push_back(Output::Local(LocalCommand::Call {
                    call,
                    subject,
                    deadline,
                    payload,
                }));
            }
            Some((subject, Source::Remote(origin))) => {
                self.call_remote(caller, &subject, origin, deadline, payload);
            }
            _ => self.answer(caller, Outcome::Unreachable, Bytes::new()),
        }
    }

    fn call_remote(
        &mut self,
        caller: Caller,
        subject: &Subject,
        origin: GatewayId,
        deadline: Option<Instant>,
        payload: Bytes,
    ) {
        let route = self.routes.get(&(subject.clone(), origin)).copied();
        let route = route.and_then(|(peer, offer)| {
            let connection = self.peers.get(&peer)?.connection;
            Some((connection, offer))
        });
        let Some((connection, offer)) = route else {
            return self.answer(caller, Outcome::Unreachable, Bytes::new());
        };
        let call = self.calls.add(caller, subject.clone(), Some(connection));
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

    /// The reply to a call has arrived.
    pub(super) fn replied(&mut self, call: CallId, outcome: Outcome, payload: Bytes) {
        let Some(call) = self.calls.remove(call) else {
            return;
        };
        match self.may_reply(&call) {
            true => self.answer(call.caller, outcome, payload),
            false => self.answer(call.caller, Outcome::Unreachable, Bytes::new()),
        }
    }

    /// A peer no longer wants the reply to its call.
    //= SM2-GWS-003
    pub(super) fn cancelled(&mut self, connection: ConnectionId, call: PeerCall) {
        self.drop_calls(|it| it.caller == Caller::Peer { connection, call });
    }

    /// A client of the domain no longer wants the reply to its call.
    pub(super) fn local_dropped(&mut self, request: RequestId) {
        self.drop_calls(|it| it.caller == Caller::Local { request });
    }

    /// A connection has ended. Its own calls are dropped; calls that it carried are unreachable.
    //= SM2-GWS-002
    pub(super) fn calls_ended(&mut self, ended: ConnectionId) {
        self.drop_calls(
            |it| matches!(it.caller, Caller::Peer { connection, .. } if connection == ended),
        );
        let lost = self.calls.remove_all(|it| it.sent_by == Some(ended));
        for call in lost.into_values() {
            self.answer(call.caller, Outcome::Unreachable, Bytes::new());
        }
    }

    fn drop_calls(&mut self, is_it: impl Fn(&OpenCall) -> bool) {
        for (call, it) in self.calls.remove_all(is_it) {
            self.outputs.push_back(match it.sent_by {
                Some(connection) => Output::Peer {
                    connection,
                    command: Command::Forget { call },
                },
                None => Output::Local(LocalCommand::Cancel { call }),
            });
        }
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
