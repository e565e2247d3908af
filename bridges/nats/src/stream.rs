//! The connection to the stream: a thread with the client of NATS, and its events.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use async_nats::jetstream::consumer::{AckPolicy, pull};
use async_nats::jetstream::{self, Context};
use async_nats::{Client, ConnectOptions, Event as Change};
use futures_util::StreamExt as _;
use sm2_bridge_core::{BridgeError, Durable, Origin};
use sm2_io::Waker;
use sm2_proto::Name;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use crate::config::Config;
use crate::message::{Message, headers, read, subject};

/// How many messages of the stream wait for the domain at most.
const PENDING_MAX: i64 = 256;
/// How long the end of a bridge waits for a slow server.
const FLUSH_MAX: Duration = Duration::from_secs(2);
/// When the stream delivers a message again that was not acknowledged.
const ACK_WAIT: Duration = Duration::from_secs(10);
/// How long a request for messages is valid. A server that starts anew does not know it any more.
const EXPIRES: Duration = Duration::from_secs(10);
/// How often a server says that it knows the request.
const HEARTBEAT: Duration = Duration::from_secs(2);
/// When the bridge asks for the stream once more.
const RETRY: Duration = Duration::from_secs(1);

/// An event of the connection.
pub(crate) enum Event {
    /// The server is there.
    Connected,
    /// The server is away.
    Disconnected,
    /// The stream has a message.
    Acknowledged(Name, Origin),
    /// A message of the stream. `None` if the domain has no names for its topic or type.
    Message(Option<Message>, Receipt),
}

/// A message of the stream that waits for an acknowledgement.
pub(crate) struct Receipt(Box<jetstream::Message>);

enum Command {
    Publish(Durable),
    Acknowledge(Receipt),
}

/// The connection. Ends when it is dropped.
pub(crate) struct Stream {
    /// `None` once it ends.
    commands: Option<UnboundedSender<Command>>,
    thread: Option<JoinHandle<()>>,
    events: Receiver<Event>,
    ready: Arc<Waker>,
}

/// The way of events to the bridge.
#[derive(Clone)]
struct Outlet {
    events: Sender<Event>,
    ready: Arc<Waker>,
}

impl Outlet {
    fn put(&self, event: Event) {
        let _ = self.events.send(event);
        self.ready.wake();
    }
}

impl Stream {
    /// Connects in the background, again and again while the server is away.
    pub(crate) fn open(config: &Config) -> Result<Self, BridgeError> {
        let ready = Arc::new(Waker::new()?);
        let (sender, events) = channel();
        let (commands, receiver) = unbounded_channel();
        let outlet = Outlet {
            events: sender,
            ready: Arc::clone(&ready),
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let config = config.clone();
        let thread = thread::Builder::new()
            .name("nats".to_owned())
            .spawn(move || runtime.block_on(run(config, receiver, outlet)))?;
        Ok(Self {
            commands: Some(commands),
            thread: Some(thread),
            events,
            ready,
        })
    }

    fn command(&self, command: Command) {
        if let Some(commands) = &self.commands {
            let _ = commands.send(command);
        }
    }

    /// Publishes a message in the stream. [`Event::Acknowledged`] follows, unless it is lost.
    pub(crate) fn publish(&self, message: Durable) {
        self.command(Command::Publish(message));
    }

    /// The domain has the message, or does not want it.
    pub(crate) fn acknowledge(&self, receipt: Receipt) {
        self.command(Command::Acknowledge(receipt));
    }

    /// A descriptor that is readable when there may be an event.
    pub(crate) const fn ready(&self) -> &Arc<Waker> {
        &self.ready
    }

    /// Lets the descriptor wait for events that come later than this call.
    pub(crate) fn clear_ready(&self) {
        self.ready.drain();
    }

    pub(crate) fn next(&self) -> Option<Event> {
        self.events.try_recv().ok()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

async fn run(config: Config, mut commands: UnboundedReceiver<Command>, outlet: Outlet) {
    let Some(client) = connect(&config, &outlet).await else {
        return;
    };
    let context = jetstream::new(client.clone());
    while let Some(mut messages) = consume_soon(&config, &context, &mut commands).await {
        outlet.put(Event::Connected);
        loop {
            tokio::select! {
                command = commands.recv() => match command {
                    Some(command) => execute(&config, &context, command, &outlet).await,
                    None => {
                        // The last acknowledgements; without them messages come again.
                        let _ = tokio::time::timeout(FLUSH_MAX, client.flush()).await;
                        return;
                    }
                },
                message = messages.next() => match message {
                    Some(Ok(message)) => {
                        let content = read(&config.prefix, &message);
                        outlet.put(Event::Message(content, Receipt(Box::new(message))));
                    }
                    // As when the server has started anew.
                    Some(Err(error)) => {
                        tracing::info!(%error, "reading the stream anew");
                        break;
                    }
                    None => break,
                },
            }
        }
    }
}

/// The messages of the stream, as soon as the server has it. `None` if the bridge ends before.
async fn consume_soon(
    config: &Config,
    context: &Context,
    commands: &mut UnboundedReceiver<Command>,
) -> Option<Messages> {
    loop {
        match consume(config, context).await {
            Ok(messages) => return Some(messages),
            Err(error) => {
                tracing::warn!(stream = config.stream, %error, "the stream cannot be used yet");
            }
        }
        tokio::select! {
            () = tokio::time::sleep(RETRY) => {}
            // A lost command comes again: the spool and the stream have not seen an acknowledgement.
            command = commands.recv() => { command?; }
        }
    }
}

async fn execute(config: &Config, context: &Context, command: Command, outlet: &Outlet) {
    match command {
        Command::Publish(message) => publish(config, context, message, outlet).await,
        Command::Acknowledge(receipt) => {
            if let Err(error) = receipt.0.ack().await {
                tracing::debug!(%error, "cannot acknowledge a message: it will come again");
            }
        }
    }
}

/// A connection that is made anew whenever it breaks.
async fn connect(config: &Config, outlet: &Outlet) -> Option<Client> {
    let changes = outlet.clone();
    let options = match &config.credentials {
        Some(file) => ConnectOptions::with_credentials_file(file).await,
        None => Ok(ConnectOptions::new()),
    };
    let options = options
        .inspect_err(|error| tracing::error!(%error, "cannot read the credentials"))
        .ok()?;
    let has_connected = OnceLock::new();
    let options = options
        .name(format!("sm2-bridge-nats {}", config.name))
        .retry_on_initial_connect()
        .event_callback(move |change| {
            match change {
                // The first one comes before the stream is known to be there.
                Change::Connected if has_connected.set(()).is_ok() => {}
                Change::Connected => changes.put(Event::Connected),
                Change::Disconnected => changes.put(Event::Disconnected),
                other => tracing::debug!(event = %other, "NATS"),
            }
            std::future::ready(())
        });
    let client = options.connect(config.servers.as_slice()).await;
    client
        .inspect_err(|error| tracing::error!(%error, "cannot connect to NATS"))
        .ok()
}

type Messages = pull::Stream;

/// Makes the stream and the consumer of this bridge, if they are missing.
async fn consume(config: &Config, context: &Context) -> Result<Messages, async_nats::Error> {
    let stream = context
        .get_or_create_stream(jetstream::stream::Config {
            name: config.stream.clone(),
            subjects: vec![format!("{}.>", config.prefix)],
            ..Default::default()
        })
        .await?;
    // Names of consumers have no dots and no slashes.
    let name = config.name.as_str().replace('/', "_");
    let consumer = stream
        .get_or_create_consumer(
            &name,
            pull::Config {
                durable_name: Some(name.clone()),
                ack_policy: AckPolicy::Explicit,
                filter_subject: format!("{}.>", config.prefix),
                max_ack_pending: PENDING_MAX,
                ack_wait: ACK_WAIT,
                ..Default::default()
            },
        )
        .await?;
    let messages = consumer.stream().expires(EXPIRES).heartbeat(HEARTBEAT);
    Ok(messages.messages().await?)
}

/// Publishes a message, and reports its acknowledgement later.
async fn publish(config: &Config, context: &Context, message: Durable, outlet: &Outlet) {
    let subject = subject(&config.prefix, &message.topic);
    let headers = headers(&message);
    let sent = context
        .publish_with_headers(subject, headers, message.payload)
        .await;
    let outlet = outlet.clone();
    match sent {
        Ok(acknowledged) => drop(tokio::spawn(async move {
            match acknowledged.await {
                Ok(_) => outlet.put(Event::Acknowledged(message.topic, message.origin)),
                // The spool sends it again.
                Err(error) => tracing::debug!(%error, "the stream has not acknowledged a message"),
            }
        })),
        Err(error) => tracing::debug!(%error, "cannot publish a message"),
    }
}
