//! Services between a domain and the network.
//!
//! A server of the domain is a queryable of Zenoh, and a server of the network is a server of the node `remote/NAME`.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use bytes::Bytes;
use sm2_bridge_core::domain::Service;
use sm2_bridge_core::{BridgeError, Delivery, Origin};
use sm2_node::clock::wall_time;
use sm2_node::wait_set::Key;
use sm2_node::{Call, Client, DeclareError, Node, RecvError, Request, Server, WaitSet};
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, QueryTarget, Queryable};

use crate::network::{CALL_MAX, Network, Request as NetworkRequest, outcome};
use crate::plain;
use crate::ready::Ready;
use crate::ros2::{self, Gid};
use crate::sender::Outcome;
use crate::sides::Sides;

/// How long a new client waits for the link to its server, so that the first call finds it.
const LINK_WAIT: Duration = Duration::from_millis(100);

/// The services that a bridge carries.
#[derive(Default)]
pub(crate) struct Services {
    /// Those of the domain.
    served: BTreeMap<Service, Served>,
    /// Those of the network.
    called: BTreeMap<Service, Called>,
    /// The calls of the network that the domain has not answered yet, by their numbers.
    calls: BTreeMap<u64, (Call<[u8]>, Form, Query)>,
    /// The calls of the domain that the network has not answered yet, by their numbers.
    requests: BTreeMap<u64, Asked>,
    /// The number of the last call.
    last_number: u64,
}

/// A call of the domain, and its service.
type Asked = (Arc<Service>, Request<[u8], [u8]>);

/// A service in the network.
pub(crate) struct Declared {
    pub(crate) key: String,
    /// The key expression of the token that shows the interface to others, where the convention has one.
    pub(crate) token: Option<String>,
    pub(crate) form: Form,
}

/// The form of requests and replies.
#[derive(Clone, Debug)]
pub(crate) enum Form {
    /// That of SM2.
    Plain(Service),
    /// That of ROS 2, with the number of the client or server.
    Ros2(Gid),
}

impl Form {
    /// The request with this number.
    fn request(&self, key: &str, payload: Bytes, origin: &Origin) -> NetworkRequest {
        let key = key.to_owned();
        match self {
            Self::Plain((_, request, _)) => NetworkRequest {
                key,
                payload,
                encoding: plain::encoding(request),
                attachment: origin.encode(Delivery::AtMostOnce),
                target: QueryTarget::BestMatching,
            },
            Self::Ros2(gid) => NetworkRequest {
                key,
                payload,
                encoding: Encoding::default(),
                attachment: ros2::encode(wall_time().0, gid, origin, Delivery::AtMostOnce),
                // As rmw_zenoh calls.
                target: QueryTarget::AllComplete,
            },
        }
    }

    /// Whether a request has the type of the service.
    fn fits(&self, query: &Query) -> bool {
        match self {
            Self::Plain((_, request, _)) => {
                let encoding = query.encoding();
                // A program of the network may not know the types of the domain.
                let Some(encoding) = encoding.filter(|it| plain::has_type(it)) else {
                    return true;
                };
                plain::type_of(encoding).as_ref() == Some(request)
            }
            // The key has the type.
            Self::Ros2(_) => true,
        }
    }

    /// The attachment of the reply to a request.
    fn reply(&self, query: &Query) -> Option<Vec<u8>> {
        match self {
            Self::Plain(_) => None,
            Self::Ros2(_) => {
                let request = query.attachment()?.to_bytes();
                Some(ros2::reply(&request, wall_time().0))
            }
        }
    }
}

/// A service of the domain, offered to the network. Ends when it is dropped.
struct Served {
    client: Client<[u8], [u8]>,
    form: Form,
    _queryable: Queryable<()>,
    _token: Option<LivelinessToken>,
}

/// A service of the network, offered to the domain. Ends when it is dropped.
struct Called {
    server: Server<[u8], [u8]>,
    /// The place of the server in the wait set. `None` while a client has as many calls as it may have: its next one
    /// would be reported again and again.
    place: Option<Key>,
    key: String,
    form: Form,
    _token: Option<LivelinessToken>,
}

impl Services {
    /// Offers these services of the domain to the network, and no others. `declare` describes one in the network.
    pub(crate) fn offer<T>(
        &mut self,
        offered: BTreeMap<Service, T>,
        sides: &Sides<'_>,
        mut declare: impl FnMut(&Service, T) -> Result<Declared, BridgeError>,
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
            let Declared { key, token, form } = declare(&service, data)?;
            // A client that sees the token may call at once.
            let queryable = sides.network.serve(key, service.clone())?;
            let token = token.map(|it| sides.network.declare_token(it));
            let served = Served {
                client,
                form,
                _queryable: queryable,
                _token: token.transpose()?,
            };
            self.served.insert(service, served);
        }
        Ok(())
    }

    /// Offers these services of the network to the domain, and no others. `declare` describes a client in the network.
    pub(crate) fn stand_for<T>(
        &mut self,
        wanted: BTreeMap<Service, T>,
        sides: &Sides<'_>,
        set: &mut WaitSet<'static, Ready>,
        mut declare: impl FnMut(&Service, T) -> Result<Declared, BridgeError>,
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
            let Declared { key, token, form } = declare(&service, data)?;
            let token = token.map(|it| sides.network.declare_token(it));
            let called = Called {
                server,
                place: Some(place),
                key,
                form,
                _token: token.transpose()?,
            };
            self.called.insert(service, called);
        }
        Ok(())
    }

    /// Passes a call of the network to the domain.
    pub(crate) fn query(
        &mut self,
        service: &Service,
        query: Query,
        network: &Network,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<(), BridgeError> {
        let Some(served) = self.served.get(service) else {
            refuse(query, "the server is gone", network);
            return Ok(());
        };
        if !served.form.fits(&query) {
            refuse(query, "the service has other types", network);
            return Ok(());
        }
        // Sending would wait for a server.
        if !has_server(&served.client) {
            refuse(query, "the server does not answer", network);
            return Ok(());
        }
        let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
        match served.client.send_timeout(&payload, CALL_MAX) {
            Ok(call) => {
                drop(payload);
                self.last_number += 1;
                let number = self.last_number;
                set.add(&call, Ready::Call(number))?;
                let form = served.form.clone();
                self.calls.insert(number, (call, form, query));
            }
            Err(error) => {
                drop(payload);
                refuse(query, &error.to_string(), network);
            }
        }
        Ok(())
    }

    /// Passes the reply to a call of the network on.
    pub(crate) fn reply(&mut self, number: u64, network: &Network) {
        let Some((call, ..)) = self.calls.get_mut(&number) else {
            return;
        };
        let reply = match call.try_wait() {
            Ok(None) => return,
            Ok(Some(reply)) => Ok(reply),
            Err(error) => Err(error),
        };
        let Some((_, form, query)) = self.calls.remove(&number) else {
            return;
        };
        match reply {
            Ok(reply) => answer(query, &form, Bytes::copy_from_slice(&reply), network),
            Err(error) => refuse(query, &error.to_string(), network),
        }
    }

    /// Passes the calls of the domain to the network.
    pub(crate) fn requests(
        &mut self,
        service: &Arc<Service>,
        network: &Network,
        origin: &Origin,
        set: &mut WaitSet<'static, Ready>,
    ) {
        let Some(called) = self.called.get_mut(service) else {
            return;
        };
        loop {
            let request = match called.server.try_recv() {
                Ok(Some(request)) => request,
                // The server has told the client.
                Err(RecvError::Payload { .. }) => continue,
                Err(RecvError::TooManyBorrowed { .. }) => {
                    called.place.take().map(|place| set.remove(place));
                    return;
                }
                Ok(None) | Err(_) => return,
            };
            self.last_number += 1;
            let number = self.last_number;
            let origin = Origin {
                number,
                ..origin.clone()
            };
            let payload = Bytes::copy_from_slice(&request);
            (self.requests).insert(number, (Arc::clone(service), request));
            network.call(called.form.request(&called.key, payload, &origin), number);
        }
    }

    /// Passes the replies to calls of the domain on. Returns how many.
    pub(crate) fn replies(
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

/// Answers a call of the network.
fn answer(query: Query, form: &Form, payload: Bytes, network: &Network) {
    let attachment = form.reply(&query);
    network.reply(payload.len(), move || {
        let reply = query.reply(query.key_expr(), payload);
        let sent = match attachment {
            Some(attachment) => reply.attachment(attachment).wait(),
            None => reply.wait(),
        };
        outcome(query.key_expr(), sent)
    });
}

fn refuse(query: Query, reason: &str, network: &Network) {
    tracing::warn!(key = %query.key_expr(), reason, "a call of the network fails");
    let reason = reason.to_owned();
    network.reply(reason.len(), move || {
        // Nobody may wait any more.
        let _ = query.reply_err(reason).wait();
        Outcome::Uncounted
    });
}
