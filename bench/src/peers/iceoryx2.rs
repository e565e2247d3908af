//! iceoryx2: samples are written into loans. Subscribers wait for an event per message, or poll.

use std::{fmt::Debug, hint, mem::MaybeUninit, time::Duration};

use iceoryx2::{
    config::Config,
    node::{Node, NodeBuilder},
    port::{
        client::Client, listener::Listener, notifier::Notifier, publisher::Publisher,
        subscriber::Subscriber,
    },
    prelude::{
        Alignment, BackpressureStrategy, FileName, Path, PortFactory, SemanticString, ServiceName,
        SignalHandlingMode, ipc,
    },
    service::port_factory::publish_subscribe,
};

use super::contract::{Call, Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS};
use crate::{
    clock::now_ns,
    control::{Stage, reached},
    job::{Channel, Domain},
};

type Ipc = ipc::Service;

/// The number of polls between two readings of the clock.
const POLLS: u32 = 256;

/// The time between two checks of a server whether to stop, in nanoseconds.
const LOOK_NS: u64 = 250_000_000;

fn failed<E: Debug>(action: &'static str) -> impl FnOnce(E) -> PeerError {
    move |error| PeerError::new(action, format!("{error:?}"))
}

/// A node.
pub struct Iceoryx2 {
    node: Node<Ipc>,
    /// True if subscribers, clients and servers sleep until an event comes.
    event: bool,
    /// True if publishers retry while a subscriber's queue is full.
    reliable: bool,
}

impl Iceoryx2 {
    fn channel_service(
        &self,
        channel: &Channel,
    ) -> Result<publish_subscribe::PortFactory<Ipc, [u8], ()>, PeerError> {
        let service = self.node.service_builder(&name(&channel.name)?);
        let service = service
            .publish_subscribe::<[u8]>()
            .payload_alignment(Alignment::new(64).unwrap_or(Alignment::ALIGN_1))
            .enable_safe_overflow(!(self.reliable || channel.lossless))
            // The default of iceoryx2 is two.
            .subscriber_max_buffer_size(channel.depth.max(2))
            .subscriber_max_borrowed_samples(1)
            .max_subscribers(16);
        service.open_or_create().map_err(failed("open a service"))
    }

    fn listener(&self, name: &str) -> Result<Option<Listener<Ipc>>, PeerError> {
        if !self.event {
            return Ok(None);
        }
        let service = self.event_service(name)?;
        let listener = service.listener_builder().create();
        listener.map(Some).map_err(failed("listen to events"))
    }

    fn notifier(&self, name: &str) -> Result<Option<Notifier<Ipc>>, PeerError> {
        if !self.event {
            return Ok(None);
        }
        let service = self.event_service(name)?;
        let notifier = service.notifier_builder().create();
        notifier.map(Some).map_err(failed("make a notifier"))
    }

    fn event_service(
        &self,
        event: &str,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<Ipc>, PeerError> {
        let service = self.node.service_builder(&name(event)?).event();
        service.open_or_create().map_err(failed("open an event"))
    }
}

fn name(name: &str) -> Result<ServiceName, PeerError> {
    ServiceName::new(name).map_err(failed("name a service"))
}

impl Peer for Iceoryx2 {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    fn open(domain: &Domain, _: &str, _: bool) -> Result<Self, PeerError> {
        let mut config = Config::default();
        let root = domain.dir.join("iceoryx2");
        let root = Path::new(root.as_os_str().as_encoded_bytes());
        config
            .global
            .set_root_path(&root.map_err(failed("name a folder"))?);
        let prefix = FileName::new(domain.tag.as_bytes());
        config.global.prefix = prefix.map_err(failed("name files"))?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>();
        Ok(Self {
            node: node.map_err(failed("make a node"))?,
            event: domain.peer != "iceoryx2-poll",
            reliable: domain.peer == "iceoryx2-event-reliable",
        })
    }

    fn publisher(&self, channel: &Channel) -> Result<Sender, PeerError> {
        let service = self.channel_service(channel)?;
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(channel.max_len)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
            .create()
            .map_err(failed("make a publisher"))?;
        Ok(Sender {
            service,
            publisher,
            notifier: self.notifier(&channel.name)?,
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let listener = self.listener(&channel.name)?;
        let subscriber = self.channel_service(channel)?.subscriber_builder().create();
        Ok(Receiver {
            subscriber: subscriber.map_err(failed("make a subscriber"))?,
            listener,
            handler,
        })
    }

    fn client(&self, channel: &Channel) -> Result<impl Call, PeerError> {
        let service = self
            .node
            .service_builder(&name(&channel.name)?)
            .request_response::<[u8], [u8]>()
            .open_or_create()
            .map_err(failed("open a service"))?;
        let listener = self.listener(&format!("{}/reply", channel.name))?;
        let client = service
            .client_builder()
            .initial_max_slice_len(channel.max_len)
            .create();
        Ok(Caller {
            client: client.map_err(failed("make a client"))?,
            notifier: self.notifier(&format!("{}/request", channel.name))?,
            listener,
        })
    }

    fn answer(
        &self,
        channel: &Channel,
        mut answer: impl FnMut(&[u8], &mut [u8]) + Send + 'static,
        ready: impl FnOnce(),
    ) -> Result<(), PeerError> {
        let service = self
            .node
            .service_builder(&name(&channel.name)?)
            .request_response::<[u8], [u8]>()
            .open_or_create()
            .map_err(failed("open a service"))?;
        let listener = self.listener(&format!("{}/request", channel.name))?;
        let notifier = self.notifier(&format!("{}/reply", channel.name))?;
        let server = service
            .server_builder()
            .initial_max_slice_len(channel.max_len)
            .create()
            .map_err(failed("make a server"))?;
        ready();
        while !reached(Stage::Stop) {
            let until_ns = now_ns() + LOOK_NS;
            while let Some(request) = wait(listener.as_ref(), until_ns, || server.receive())? {
                let response = request.loan_slice_uninit(request.payload().len());
                let mut response = response.map_err(failed("get memory for a reply"))?;
                answer(request.payload(), written(response.payload_mut()));
                // SAFETY: `answer` has written the reply, and `written` says why all bytes are
                // initialized even if it has not.
                let response = unsafe { response.assume_init() };
                response.send().map_err(failed("reply"))?;
                notify(notifier.as_ref())?;
            }
        }
        Ok(())
    }
}

/// The loaned memory as bytes to write to. `loan_slice` of iceoryx2 would write zeros first, which
/// is another pass over the message.
fn written(loan: &mut [MaybeUninit<u8>]) -> &mut [u8] {
    // SAFETY: the memory belongs to a file in shared memory. The kernel fills its pages with zeros,
    // and only bytes have been stored since, so all of it is initialized.
    unsafe { &mut *(std::ptr::from_mut(loan) as *mut [u8]) }
}

fn notify(notifier: Option<&Notifier<Ipc>>) -> Result<(), PeerError> {
    if let Some(notifier) = notifier {
        notifier.notify().map_err(failed("notify"))?;
    }
    Ok(())
}

/// Takes one item; waits for an event, or polls, until there is one or the time is over.
fn wait<T, E: Debug>(
    listener: Option<&Listener<Ipc>>,
    until_ns: u64,
    mut take: impl FnMut() -> Result<Option<T>, E>,
) -> Result<Option<T>, PeerError> {
    loop {
        let polls = if listener.is_some() { 1 } else { POLLS };
        for _ in 0..polls {
            if let Some(taken) = take().map_err(failed("receive"))? {
                return Ok(Some(taken));
            }
            hint::spin_loop();
        }
        let now = now_ns();
        if now >= until_ns {
            return Ok(None);
        }
        if let Some(listener) = listener {
            let timeout = Duration::from_nanos(until_ns - now);
            listener
                .timed_wait(|_| {}, timeout)
                .map_err(failed("wait for an event"))?;
        }
    }
}

/// A publisher.
pub struct Sender {
    service: publish_subscribe::PortFactory<Ipc, [u8], ()>,
    publisher: Publisher<Ipc, [u8], ()>,
    notifier: Option<Notifier<Ipc>>,
}

// SAFETY: a `Sender` is never moved to another thread. `Handler` requires `Send` for peers that
// call handlers on threads of their own, and the handler of an echo holds a `Sender`. `Receiver`
// below calls its handler on the thread that made both.
unsafe impl Send for Sender {}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        let sample = self.publisher.loan_slice_uninit(len);
        let mut sample = sample.map_err(failed("get memory for a message"))?;
        write(written(sample.payload_mut()));
        // SAFETY: `write` has written the message, and `written` says why all bytes are initialized
        // even if it has not.
        let sample = unsafe { sample.assume_init() };
        sample.send().map_err(failed("send"))?;
        notify(self.notifier.as_ref())
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        Ok(self.service.dynamic_config().number_of_subscribers())
    }
}

/// A subscriber.
pub struct Receiver<H> {
    subscriber: Subscriber<Ipc, [u8], ()>,
    listener: Option<Listener<Ipc>>,
    handler: H,
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        let take = || self.subscriber.receive();
        while let Some(sample) = wait(self.listener.as_ref(), until_ns, take)? {
            if self.handler.message(sample.payload()) == Flow::Return {
                return Ok(());
            }
        }
        Ok(())
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.handler)
    }
}

/// A client.
struct Caller {
    client: Client<Ipc, [u8], (), [u8], ()>,
    notifier: Option<Notifier<Ipc>>,
    listener: Option<Listener<Ipc>>,
}

impl Call for Caller {
    fn call(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError> {
        let request = self.client.loan_slice_uninit(len);
        let mut request = request.map_err(failed("get memory for a request"))?;
        write(written(request.payload_mut()));
        // SAFETY: `write` has written the request, and `written` says why all bytes are initialized
        // even if it has not.
        let request = unsafe { request.assume_init() };
        let pending = request.send().map_err(failed("send a request"))?;
        notify(self.notifier.as_ref())?;
        let until_ns = now_ns() + TIMEOUT_NS;
        match wait(self.listener.as_ref(), until_ns, || pending.receive())? {
            Some(response) => {
                read(response.payload());
                Ok(())
            }
            None => Err(PeerError::new("call", "timed out")),
        }
    }
}
