//! The calls of services by a viewer.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::Duration,
};

use sm2_node::{Call, CallError, Client, Reply};

use super::context::{Context, End, Source};
use crate::{
    catalogue::Service,
    frame,
    protocol::{self, ToViewer},
};

/// A call without a reply fails after this time.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The calls of a viewer that may be pending for each server of a service.
const PENDING_MAX: u16 = 16;

/// The reason of a failed call, for people.
type Reason = Box<dyn std::error::Error + Send + Sync>;

/// The calls of a viewer that are pending.
#[derive(Default)]
pub(super) struct Calls {
    /// The clients of the services that the viewer has called.
    clients: HashMap<u32, Client<[u8], [u8]>>,
    pending: BTreeMap<u64, Pending>,
    last_id: u64,
}

struct Pending {
    service: Arc<Service>,
    /// The number that the viewer has given to the call.
    number: u32,
    call: Call<[u8]>,
}

impl Calls {
    /// Forgets the clients of services that have ended. Their pending calls end by themselves.
    pub(super) fn end(&mut self, services: &[u32]) {
        services.iter().for_each(|id| drop(self.clients.remove(id)));
    }

    /// Sends a request.
    pub(super) fn start(
        &mut self,
        context: &mut Context,
        service_id: u32,
        number: u32,
        encoding: &str,
        payload: &[u8],
    ) -> Result<(), End> {
        match self.send_request(context, service_id, encoding, payload) {
            Ok((service, call)) => {
                self.last_id += 1;
                let id = self.last_id;
                context.set.add(&call, Source::Call(id))?;
                let pending = Pending {
                    service,
                    number,
                    call,
                };
                self.pending.insert(id, pending);
                Ok(())
            }
            Err(error) => fail(context, service_id, number, error.to_string()),
        }
    }

    fn send_request(
        &mut self,
        context: &Context,
        service_id: u32,
        encoding: &str,
        payload: &[u8],
    ) -> Result<(Arc<Service>, Call<[u8]>), Reason> {
        let service = context.snapshot.services.get(&service_id);
        let service = Arc::clone(service.ok_or("there is no such service any more")?);
        let request = service.request.to_domain(encoding, payload)?;
        let client = match self.clients.remove(&service_id) {
            Some(client) => client,
            None => {
                let (request, reply) = service.types.clone();
                let builder = context
                    .shared
                    .node
                    .client_builder::<[u8], [u8]>(service.name.as_str());
                builder
                    .type_ids(request, reply)
                    .max_borrowed(PENDING_MAX)
                    .declare()?
            }
        };
        let call = client.send_timeout(&request, TIMEOUT);
        self.clients.insert(service_id, client);
        Ok((service, call?))
    }

    /// Sends the reply of a call to the viewer.
    pub(super) fn take_reply(&mut self, context: &mut Context, id: u64) -> Result<(), End> {
        let Some(pending) = self.pending.get_mut(&id) else {
            return Ok(());
        };
        let (service, number) = (Arc::clone(&pending.service), pending.number);
        let framed = match pending.call.try_wait() {
            Ok(None) => {
                // A call leaves the set when it is reported.
                context.set.add(&pending.call, Source::Call(id))?;
                return Ok(());
            }
            result => framed(&service, number, result),
        };
        self.pending.remove(&id);
        match framed {
            Ok(frame) => context.control(frame),
            Err(error) => fail(context, service.id, number, error.to_string()),
        }
    }
}

/// The frame of a reply.
fn framed(
    service: &Service,
    number: u32,
    result: Result<Option<Reply<[u8]>>, CallError>,
) -> Result<Vec<u8>, Reason> {
    let reply = result?.ok_or("there is no reply")?;
    // A copy: the server may still be able to change the reply while it is decoded.
    let reply = reply.to_vec();
    let payload = service.reply.to_viewer(&reply)?;
    let encoding = service.reply.messages().encoding;
    let head = protocol::reply_head(service.id, number, encoding);
    Ok(frame::binary(&[&head, &payload]))
}

/// Tells the viewer that a call has failed.
fn fail(context: &mut Context, service_id: u32, call_id: u32, message: String) -> Result<(), End> {
    context.send(&ToViewer::ServiceCallFailure {
        service_id,
        call_id,
        message,
    })
}
