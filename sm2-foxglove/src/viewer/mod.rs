//! One viewer: a thread that owns the connection, the subscriptions and all else of it.
//!
//! A viewer has subscribers of its own. So it gets the latched messages of a topic, although another viewer looks at
//! the topic already, and viewers cannot delay each other.

mod calls;
mod context;
mod publications;
mod subscriptions;

use std::{convert::Infallible, io, net::TcpStream, sync::Arc, time::Duration};

use sm2_node::{
    Shutdown, Timer, WaitSet,
    wait_set::{Interest, Key},
};
use tungstenite::Message;

use self::{
    calls::Calls,
    context::{Context, End, Source},
    publications::Publications,
    subscriptions::Subscriptions,
};
use crate::{
    catalogue::Snapshot,
    connection::Connection,
    frame,
    graph::Graph,
    news::Bell,
    outbox::Outbox,
    protocol::{self, BinaryFromViewer, FromViewer, Level, ToViewer},
    shared::Shared,
};

/// Messages of the viewer that are handled before the other sources have their turn.
const READ_BURST: usize = 64;

/// The time between two reports of the domain's time.
const TICK: Duration = Duration::from_millis(100);

/// The status code of a connection whose server ends.
const GOING_AWAY: u16 = 1001;
/// The status code of a connection after which the viewer connects again.
const RESTART: u16 = 1012;
/// The status code of a connection that has failed.
const FAILED: u16 = 1011;

/// A viewer that is connected.
struct Viewer {
    context: Context,
    tcp: Arc<TcpStream>,
    /// The key of [`Source::Writable`], while there is something to write.
    writable: Option<Key>,
    bell: Arc<Bell>,
    /// The graph that the viewer knows, if it wants the graph.
    graph: Option<Graph>,
    subscriptions: Subscriptions,
    calls: Calls,
    publications: Publications,
}

/// Serves a client until its connection ends. Returns the reason.
pub(crate) fn serve(shared: &Arc<Shared>, tcp: Arc<TcpStream>, shutdown: &Shutdown) -> End {
    let mut connection = match Connection::accept(Arc::clone(&tcp), &shared.access) {
        Ok(connection) => connection,
        Err(error) => return error.into(),
    };
    let mut viewer = match Viewer::new(shared, tcp, shutdown) {
        Ok(viewer) => viewer,
        Err(error) => return error.into(),
    };
    let Err(end) = viewer.run(&mut connection);
    let code = match end {
        End::OtherClock => RESTART,
        End::Shutdown => GOING_AWAY,
        End::Accept(_) | End::Gone(_) | End::System(_) => FAILED,
    };
    let displaced = viewer.context.outbox.displaced();
    tracing::debug!(displaced, "newer messages have displaced this many");
    connection.close(viewer.context.outbox, code);
    end
}

impl Viewer {
    fn new(shared: &Arc<Shared>, tcp: Arc<TcpStream>, shutdown: &Shutdown) -> io::Result<Self> {
        let bell = Arc::new(shared.news.bell()?);
        let mut set = WaitSet::new()?;
        set.end_with(shutdown)?;
        set.add_descriptor(
            Descriptor(Arc::clone(&tcp)),
            Interest::Readable,
            Source::Readable,
        )?;
        set.add_descriptor(
            Descriptor(Arc::clone(&bell)),
            Interest::Readable,
            Source::News,
        )?;
        let has_clock = shared.news.snapshot().has_clock;
        let clock = match has_clock {
            // Without an answer of the Manager, the times are those of the wall clock.
            true => shared.node.clock().ok(),
            false => None,
        };
        if clock.is_some() {
            set.add_timer(Timer::every(TICK), Source::Tick);
        }
        Ok(Self {
            context: Context {
                shared: Arc::clone(shared),
                set,
                outbox: Outbox::new(shared.options.viewer_budget_bytes),
                snapshot: Arc::new(Snapshot {
                    has_clock,
                    ..Snapshot::default()
                }),
                clock,
            },
            tcp,
            writable: None,
            bell,
            graph: None,
            subscriptions: Subscriptions::default(),
            calls: Calls::default(),
            publications: Publications::default(),
        })
    }

    fn run(&mut self, connection: &mut Connection) -> Result<Infallible, End> {
        self.greet()?;
        self.take_news()?;
        loop {
            self.write(connection)?;
            let ready = self.context.set.wait()?;
            let context = &mut self.context;
            match ready.tag {
                Source::Readable => self.read(connection)?,
                // The loop writes.
                Source::Writable => {}
                Source::News => {
                    self.bell.drain();
                    self.take_news()?;
                }
                Source::Topic(id) => self.subscriptions.take_messages(context, id)?,
                Source::Call(id) => self.calls.take_reply(context, id)?,
                Source::Tick => self.send_time()?,
            }
        }
    }

    /// Writes what the socket takes, and waits for it while there is more.
    fn write(&mut self, connection: &mut Connection) -> Result<(), End> {
        let blocked = connection.write(&mut self.context.outbox)?;
        match (blocked, self.writable) {
            (true, None) => {
                // The same socket, under another descriptor: the set has one interest for each.
                let tcp = self.tcp.try_clone()?;
                let key =
                    self.context
                        .set
                        .add_descriptor(tcp, Interest::Writable, Source::Writable)?;
                self.writable = Some(key);
            }
            (false, Some(key)) => {
                self.context.set.remove(key);
                self.writable = None;
            }
            _ => {}
        }
        Ok(())
    }

    fn read(&mut self, connection: &mut Connection) -> Result<(), End> {
        for _ in 0..READ_BURST {
            match connection.read(&mut self.context.outbox)? {
                None => break,
                Some(Message::Text(text)) => match serde_json::from_str(&text) {
                    Ok(message) => self.handle(message)?,
                    Err(error) => self
                        .context
                        .complain(Level::Error, format!("no message: {error}"))?,
                },
                Some(Message::Binary(bytes)) => self.handle_binary(&bytes)?,
                Some(_) => {}
            }
        }
        Ok(())
    }

    fn handle(&mut self, message: FromViewer) -> Result<(), End> {
        let context = &mut self.context;
        match message {
            FromViewer::Subscribe { subscriptions } => {
                for subscription in subscriptions {
                    self.subscriptions.add(context, subscription)?;
                }
            }
            FromViewer::Unsubscribe { subscription_ids } => {
                subscription_ids
                    .into_iter()
                    .for_each(|id| self.subscriptions.remove(context, id));
            }
            FromViewer::Advertise { channels } => {
                for publication in channels {
                    self.publications.add(context, &publication)?;
                }
            }
            FromViewer::Unadvertise { channel_ids } => self.publications.remove(&channel_ids),
            FromViewer::SubscribeConnectionGraph => {
                self.graph = Some(Graph::default());
                self.send_graph()?;
            }
            FromViewer::UnsubscribeConnectionGraph => self.graph = None,
            FromViewer::Unsupported => {
                self.context.complain(
                    Level::Warning,
                    "this server does not offer the operation".to_owned(),
                )?;
            }
        }
        Ok(())
    }

    fn handle_binary(&mut self, message: &[u8]) -> Result<(), End> {
        let context = &mut self.context;
        match protocol::binary(message) {
            Some(BinaryFromViewer::Message {
                publication,
                payload,
            }) => self.publications.publish(context, publication, payload),
            Some(BinaryFromViewer::Request {
                service,
                call,
                encoding,
                payload,
            }) => self.calls.start(context, service, call, encoding, payload),
            None => self
                .context
                .complain(Level::Error, "a binary message of no known kind".to_owned()),
        }
    }

    /// Tells the viewer about the server.
    fn greet(&mut self) -> Result<(), End> {
        let mut capabilities = vec!["services", "connectionGraph"];
        if self.context.clock.is_some() {
            capabilities.push("time");
        }
        if self.context.shared.options.allow_publish {
            capabilities.push("clientPublish");
        }
        let shared = Arc::clone(&self.context.shared);
        self.context.send(&ToViewer::ServerInfo {
            name: &shared.name,
            capabilities: &capabilities,
            supported_encodings: &["cdr", "json"],
            session_id: &shared.session,
        })
    }

    /// Tells the viewer about the changes of the domain.
    fn take_news(&mut self) -> Result<(), End> {
        let now = self.context.shared.news.snapshot();
        let before = std::mem::replace(&mut self.context.snapshot, Arc::clone(&now));
        if now.has_clock != before.has_clock {
            return Err(End::OtherClock);
        }
        let gone = |it: &&u64| !now.channels.contains_key(it);
        let channel_ids: Vec<_> = before.channels.keys().filter(gone).copied().collect();
        if !channel_ids.is_empty() {
            self.subscriptions.end(&mut self.context, &channel_ids);
            self.context.send(&ToViewer::Unadvertise { channel_ids })?;
        }
        let new = now
            .channels
            .values()
            .filter(|it| !before.channels.contains_key(&it.id));
        let channels: Vec<_> = new.map(|it| it.advertisement()).collect();
        if !channels.is_empty() {
            self.context.send(&ToViewer::Advertise { channels })?;
        }
        let gone = |it: &&u32| !now.services.contains_key(it);
        let service_ids: Vec<_> = before.services.keys().filter(gone).copied().collect();
        if !service_ids.is_empty() {
            self.calls.end(&service_ids);
            self.context
                .send(&ToViewer::UnadvertiseServices { service_ids })?;
        }
        let new = now
            .services
            .values()
            .filter(|it| !before.services.contains_key(&it.id));
        let services: Vec<_> = new.map(|it| it.advertisement()).collect();
        if !services.is_empty() {
            self.context
                .send(&ToViewer::AdvertiseServices { services })?;
        }
        self.send_graph()
    }

    /// Tells the viewer about the changes of the graph, if it wants the graph.
    fn send_graph(&mut self) -> Result<(), End> {
        let Some(known) = &mut self.graph else {
            return Ok(());
        };
        let update = self.context.snapshot.graph.update(known);
        known.clone_from(&self.context.snapshot.graph);
        match update {
            Some(update) => self.context.send(&ToViewer::ConnectionGraphUpdate(update)),
            None => Ok(()),
        }
    }

    fn send_time(&mut self) -> Result<(), End> {
        match &self.context.clock {
            Some(clock) => {
                let time = protocol::time(clock.now());
                self.context.control(frame::binary(&[&time]))
            }
            None => Ok(()),
        }
    }
}

/// A descriptor that the wait set and the viewer share.
struct Descriptor<T>(Arc<T>);

impl<T: std::os::fd::AsFd> std::os::fd::AsFd for Descriptor<T> {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.0.as_fd()
    }
}
