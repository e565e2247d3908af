//! Services between a domain and nodes of ROS 2.
//!
//! A server of the domain is a queryable of Zenoh, and a server of ROS 2 is a server of the node `remote/NAME`.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use hiroz_protocol::EndpointKind;
use hiroz_protocol::qos::QosProfile;
use sm2_bridge_core::BridgeError;
use sm2_bridge_core::Origin;
use sm2_bridge_core::domain::Service;
use sm2_node::clock::wall_time;
use sm2_node::wait_set::Key;
use sm2_node::{Call, CallError, Client, DeclareError, Node, RecvError, Request, Server, WaitSet};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

use super::attachment::{self, Gid};
use super::identity::{Identity, declare_token, gid, key};
use super::types::RosType;
use crate::network::{CALL_MAX, Network};
use crate::ready::Ready;
use crate::sides::Sides;

/// How long a new client waits for the link to its server, so that the first call finds it.
const LINK_WAIT: Duration = Duration::from_millis(100);

/// The services that a bridge carries.
#[derive(Default)]
pub(super) struct Services {
    /// Those of the domain.
    served: BTreeMap<Service, Served>,
    /// Those of the network.
    called: BTreeMap<Service, Called>,
    /// The calls of the network that the domain has not answered yet, by their numbers.
    calls: BTreeMap<u64, (Call<[u8]>, Query)>,
    /// The calls of the domain that the network has not answered yet, by their numbers.
    requests: BTreeMap<u64, Asked>,
    /// The number of the last call.
    last_number: u64,
}

/// A call of the domain, and its service.
type Asked = (Arc<Service>, Request<[u8], [u8]>);

/// A service of the domain, offered to the network. Ends when it is dropped.
struct Served {
    client: Client<[u8], [u8]>,
    _queryable: Queryable<()>,
    _token: LivelinessToken,
}

/// A service of the network, offered to the domain. Ends when it is dropped.
struct Called {
    server: Server<[u8], [u8]>,
    /// The place of the server in the wait set. `None` while a client has as many calls as it may have: its next one
    /// would be reported again and again.
    place: Option<Key>,
    key: String,
    gid: Gid,
    _token: LivelinessToken,
}

impl Services {
    /// Offers these services of the domain to the network, and no others.
    pub(super) fn offer(
        &mut self,
        offered: BTreeMap<Service, RosType>,
        sides: &Sides<'_>,
        identity: &mut Identity,
    ) -> Result<(), BridgeError> {
        self.served.retain(|it, _| offered.contains_key(it));
        for (service, data) in offered {
            if self.served.contains_key(&service) {
                continue;
            }
            let client = match client(sides.node, &service) {
                Ok(client) => client,
                Err(error) => {
                    tracing::warn!(service = %service.0, %error, "cannot be a client");
                    continue;
                }
            };
            let qos = QosProfile::default();
            let endpoint = identity.endpoint(EndpointKind::Service, &service.0, &data, qos);
            let served = Served {
                client,
                _queryable: (sides.network).serve(key(&endpoint)?, service.clone())?,
                _token: declare_token(&endpoint, sides.network)?,
            };
            self.served.insert(service, served);
        }
        Ok(())
    }

    /// Offers these services of the network to the domain, and no others.
    pub(super) fn stand_for(
        &mut self,
        wanted: BTreeMap<Service, RosType>,
        sides: &Sides<'_>,
        identity: &mut Identity,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<(), BridgeError> {
        self.called.retain(|service, it| {
            let is_wanted = wanted.contains_key(service);
            if let (false, Some(place)) = (is_wanted, it.place) {
                set.remove(place);
            }
            is_wanted
        });
        for (service, data) in wanted {
            if self.called.contains_key(&service) {
                continue;
            }
            let (name, request, reply) = service.clone();
            let builder = sides.remote.server_builder::<[u8], [u8]>(name.as_str());
            let server = match builder.type_ids(request, reply).declare() {
                Ok(server) => server,
                Err(error) => {
                    tracing::warn!(service = %name, %error, "cannot be a server");
                    continue;
                }
            };
            let place = set.add(&server, Ready::Server(Arc::new(service.clone())))?;
            let qos = QosProfile::default();
            let endpoint = identity.endpoint(EndpointKind::Client, &name, &data, qos);
            let called = Called {
                server,
                place: Some(place),
                key: key(&endpoint)?,
                gid: gid(&endpoint, sides.network),
                _token: declare_token(&endpoint, sides.network)?,
            };
            self.called.insert(service, called);
        }
        Ok(())
    }

    /// Passes a call of the network to the domain.
    pub(super) fn query(
        &mut self,
        service: &Service,
        query: Query,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<(), BridgeError> {
        let Some(served) = self.served.get(service) else {
            refuse(&query, "the server is gone");
            return Ok(());
        };
        // Sending would wait for a server.
        if !has_server(&served.client) {
            refuse(&query, "the server does not answer");
            return Ok(());
        }
        let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
        match served.client.send_timeout(&payload, CALL_MAX) {
            Ok(call) => {
                drop(payload);
                self.last_number += 1;
                let number = self.last_number;
                set.add(&call, Ready::Call(number))?;
                self.calls.insert(number, (call, query));
            }
            Err(error) => refuse(&query, &error.to_string()),
        }
        Ok(())
    }

    /// Passes the reply to a call of the network on. Returns whether there was one.
    pub(super) fn reply(&mut self, number: u64) -> bool {
        let Some((call, _)) = self.calls.get_mut(&number) else {
            return false;
        };
        let reply = match call.try_wait() {
            Ok(None) => return false,
            Ok(Some(reply)) => Ok(reply),
            Err(error) => Err(error),
        };
        let Some((_, query)) = self.calls.remove(&number) else {
            return false;
        };
        answer(&query, reply.as_deref())
    }

    /// Passes the calls of the domain to the network. Returns how many.
    pub(super) fn requests(
        &mut self,
        service: &Arc<Service>,
        network: &Network,
        origin: &Origin,
        set: &mut WaitSet<'static, Ready>,
    ) -> u64 {
        let Some(called) = self.called.get_mut(service) else {
            return 0;
        };
        let mut count = 0;
        loop {
            let request = match called.server.try_recv() {
                Ok(Some(request)) => request,
                // The server has told the client.
                Err(RecvError::Payload { .. }) => continue,
                Err(RecvError::TooManyBorrowed { .. }) => {
                    called.place.take().map(|place| set.remove(place));
                    return count;
                }
                Ok(None) | Err(_) => return count,
            };
            self.last_number += 1;
            let number = self.last_number;
            let origin = Origin {
                number,
                ..origin.clone()
            };
            let attachment = attachment::encode(wall_time().0, &called.gid, &origin);
            match network.call(&called.key, &request, attachment, number) {
                Ok(()) => {
                    count += 1;
                    (self.requests).insert(number, (Arc::clone(service), request));
                }
                Err(error) => drop(request.fail(&error.to_string())),
            }
        }
    }

    /// Passes the replies to calls of the domain on. Returns how many.
    pub(super) fn replies(
        &mut self,
        network: &Network,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<u64, BridgeError> {
        let mut count = 0;
        while let Some((number, payload)) = network.next_reply() {
            let Some((service, request)) = self.requests.remove(&number) else {
                continue;
            };
            count += u64::from(payload.is_some());
            // The client may be gone.
            let _ = match payload {
                Some(payload) => request.reply(&payload.to_bytes()),
                None => request.fail("no server of the network has replied"),
            };
            if let Some(called) = self.called.get_mut(&*service)
                && called.place.is_none()
            {
                called.place = Some(set.add(&called.server, Ready::Server(service))?);
            }
        }
        Ok(count)
    }
}

/// Declares a client, and waits a short time for its server.
fn client(node: &Node, service: &Service) -> Result<Client<[u8], [u8]>, DeclareError> {
    let (name, request, reply) = service.clone();
    let builder = node.client_builder::<[u8], [u8]>(name.as_str());
    // Servers of the network are not offered to it again.
    let builder = builder.servers(|node| !sm2_gateway::is_remote(node));
    let client = builder.type_ids(request, reply).declare()?;
    let until = Instant::now() + LINK_WAIT;
    while !has_server(&client) && Instant::now() < until {
        thread::sleep(Duration::from_millis(1));
    }
    Ok(client)
}

fn has_server(client: &Client<[u8], [u8]>) -> bool {
    client.links().iter().any(|it| it.open)
}

/// Answers a call of the network. Returns whether it is a reply.
fn answer(query: &Query, reply: Result<&[u8], &CallError>) -> bool {
    match reply {
        Ok(bytes) => {
            let reply = query.reply(query.key_expr(), bytes);
            let attachment = query.attachment().map(|it| it.to_bytes().into_owned());
            let sent = match attachment {
                Some(attachment) => reply
                    .attachment(attachment::reply(&attachment, wall_time().0))
                    .wait(),
                None => reply.wait(),
            };
            if let Err(error) = sent {
                tracing::warn!(key = %query.key_expr(), %error, "Zenoh refuses a reply");
                return false;
            }
            true
        }
        Err(error) => {
            refuse(query, &error.to_string());
            false
        }
    }
}

fn refuse(query: &Query, reason: &str) {
    tracing::warn!(key = %query.key_expr(), reason, "a call of the network fails");
    // Nobody may wait any more.
    let _ = query.reply_err(reason).wait();
}
