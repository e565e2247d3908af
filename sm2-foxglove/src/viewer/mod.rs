//! One viewer: a thread that owns the connection, the subscriptions and all else of it.
//!
//! A viewer has subscribers of its own. So it gets the latched messages of a topic, although another viewer looks at
//! the topic already, and viewers cannot delay each other.

mod calls;
mod publications;
mod subscriptions;

use std::{io, net::TcpStream, sync::Arc, time::Duration};

use sm2_node::{
    Shutdown, Timer, WaitError, WaitSet,
    clock::{self, Clock, DomainTime},
    wait_set::{Interest, Key},
};
use sm2_proto::Instant;
use tungstenite::Message;

use self::{calls::Calls, publications::Publications, subscriptions::Subscriptions};
use crate::{
    catalogue::Snapshot,
    connection::{AcceptError, Connection, Gone},
    frame,
    graph::Graph,
    news::Bell,
    outbox::{Frame, Outbox},
    protocol::{self, BinaryFromViewer, FromViewer, Level, ToViewer},
    server::Shared,
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

/// The sources that wake the thread of a viewer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    /// The viewer has sent something.
    Readable,
    /// The socket takes bytes again.
    Writable,
    /// The domain has changed.
    News,
    /// A subscription has messages.
    Topic(u32),
    /// A call has ended.
    Call(u64),
    /// The viewer gets the time of the domain.
    Tick,
}

/// The reason for the end of a viewer's thread.
#[derive(Debug, thiserror::Error)]
pub(crate) enum End {
    #[error(transparent)]
    Accept(#[from] AcceptError),
    #[error("{0}")]
    Gone(#[from] Gone),
    #[error("the time of the domain is another one now: the viewer connects again")]
    OtherClock,
    #[error("the server ends")]
    Shutdown,
    #[error("the operating system refuses a resource: {0}")]
    System(#[from] io::Error),
}

impl From<WaitError> for End {
    fn from(error: WaitError) -> Self {
        match error {
            WaitError::Shutdown => Self::Shutdown,
            WaitError::Io(source) => Self::System(source),
            other => Self::System(io::Error::other(other)),
        }
    }
}

/// A viewer that is connected.
struct Viewer {
    shared: Arc<Shared>,
    set: WaitSet<'static, Source>,
    tcp: Arc<TcpStream>,
    outbox: Outbox,
    /// The key of [`Source::Writable`], while there is something to write.
    writable: Option<Key>,
    bell: Arc<Bell>,
    /// The state that the viewer knows.
    snapshot: Arc<Snapshot>,
    /// The graph that the viewer knows, if it wants the graph.
    graph: Option<Graph>,
    /// The clock of a domain with simulated time.
    clock: Option<Clock>,
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
    tracing::info!(
        displaced = viewer.outbox.displaced(),
        "the connection of a viewer has ended"
    );
    connection.close(viewer.outbox, code);
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
            set,
            tcp,
            outbox: Outbox::new(shared.options.viewer_budget_bytes),
            writable: None,
            bell,
            snapshot: Arc::new(Snapshot {
                has_clock,
                ..Snapshot::default()
            }),
            graph: None,
            clock,
            subscriptions: Subscriptions::default(),
            calls: Calls::default(),
            publications: Publications::default(),
            shared: Arc::clone(shared),
        })
    }

    fn run(&mut self, connection: &mut Connection) -> Result<std::convert::Infallible, End> {
        self.greet()?;
        self.take_news()?;
        loop {
            self.write(connection)?;
            let ready = self.set.wait()?;
            match ready.tag {
                Source::Readable => self.read(connection)?,
                // The loop writes.
                Source::Writable => {}
                Source::News => {
                    self.bell.silence();
                    self.take_news()?;
                }
                Source::Topic(id) => self.take_messages(id)?,
                Source::Call(id) => self.take_reply(id)?,
                Source::Tick => self.send_time()?,
            }
        }
    }

    /// Writes what the socket takes, and waits for it while there is more.
    fn write(&mut self, connection: &mut Connection) -> Result<(), End> {
        let blocked = connection.write(&mut self.outbox)?;
        match (blocked, self.writable) {
            (true, None) => {
                // The same socket, under another descriptor: the set has one interest for each.
                let tcp = self.tcp.try_clone()?;
                let key = self
                    .set
                    .add_descriptor(tcp, Interest::Writable, Source::Writable)?;
                self.writable = Some(key);
            }
            (false, Some(key)) => {
                self.set.remove(key);
                self.writable = None;
            }
            _ => {}
        }
        Ok(())
    }

    fn read(&mut self, connection: &mut Connection) -> Result<(), End> {
        for _ in 0..READ_BURST {
            match connection.read(&mut self.outbox)? {
                None => break,
                Some(Message::Text(text)) => match serde_json::from_str(&text) {
                    Ok(message) => self.handle(message)?,
                    Err(error) => self.complain(Level::Error, format!("no message: {error}"))?,
                },
                Some(Message::Binary(bytes)) => self.handle_binary(&bytes)?,
                Some(_) => {}
            }
        }
        Ok(())
    }

    fn handle(&mut self, message: FromViewer) -> Result<(), End> {
        match message {
            FromViewer::Subscribe { subscriptions } => {
                for subscription in subscriptions {
                    self.subscribe(subscription)?;
                }
            }
            FromViewer::Unsubscribe { subscription_ids } => {
                subscription_ids
                    .into_iter()
                    .for_each(|id| self.unsubscribe(id));
            }
            FromViewer::Advertise { channels } => {
                for publication in channels {
                    self.advertise(&publication)?;
                }
            }
            FromViewer::Unadvertise { channel_ids } => self.publications.remove(&channel_ids),
            FromViewer::SubscribeConnectionGraph => {
                self.graph = Some(Graph::default());
                self.send_graph()?;
            }
            FromViewer::UnsubscribeConnectionGraph => self.graph = None,
            FromViewer::Unsupported => {
                self.complain(
                    Level::Warning,
                    "this server does not offer the operation".to_owned(),
                )?;
            }
        }
        Ok(())
    }

    fn handle_binary(&mut self, message: &[u8]) -> Result<(), End> {
        match protocol::binary(message) {
            Some(BinaryFromViewer::Message {
                publication,
                payload,
            }) => self.publish(publication, payload),
            Some(BinaryFromViewer::Request {
                service,
                call,
                encoding,
                payload,
            }) => self.call(service, call, encoding, payload),
            None => self.complain(Level::Error, "a binary message of no known kind".to_owned()),
        }
    }

    /// Tells the viewer about the server.
    fn greet(&mut self) -> Result<(), End> {
        let mut capabilities = vec!["services", "connectionGraph"];
        if self.clock.is_some() {
            capabilities.push("time");
        }
        if self.shared.options.allow_publish {
            capabilities.push("clientPublish");
        }
        let shared = Arc::clone(&self.shared);
        self.send(&ToViewer::ServerInfo {
            name: &shared.name,
            capabilities: &capabilities,
            supported_encodings: &["cdr", "json"],
            session_id: &shared.session,
        })
    }

    /// Tells the viewer about the changes of the domain.
    fn take_news(&mut self) -> Result<(), End> {
        let now = self.shared.news.snapshot();
        let before = std::mem::replace(&mut self.snapshot, Arc::clone(&now));
        if now.has_clock != before.has_clock {
            return Err(End::OtherClock);
        }
        let gone = |it: &&u64| !now.channels.contains_key(it);
        let channel_ids: Vec<_> = before.channels.keys().filter(gone).copied().collect();
        if !channel_ids.is_empty() {
            self.end_subscriptions(&channel_ids);
            self.send(&ToViewer::Unadvertise { channel_ids })?;
        }
        let new = now
            .channels
            .values()
            .filter(|it| !before.channels.contains_key(&it.id));
        let channels: Vec<_> = new.map(|it| it.advertisement()).collect();
        if !channels.is_empty() {
            self.send(&ToViewer::Advertise { channels })?;
        }
        let gone = |it: &&u32| !now.services.contains_key(it);
        let service_ids: Vec<_> = before.services.keys().filter(gone).copied().collect();
        if !service_ids.is_empty() {
            self.calls.end(&service_ids);
            self.send(&ToViewer::UnadvertiseServices { service_ids })?;
        }
        let new = now
            .services
            .values()
            .filter(|it| !before.services.contains_key(&it.id));
        let services: Vec<_> = new.map(|it| it.advertisement()).collect();
        if !services.is_empty() {
            self.send(&ToViewer::AdvertiseServices { services })?;
        }
        self.send_graph()
    }

    /// Tells the viewer about the changes of the graph, if it wants the graph.
    fn send_graph(&mut self) -> Result<(), End> {
        let Some(known) = &mut self.graph else {
            return Ok(());
        };
        let update = self.snapshot.graph.update(known);
        known.clone_from(&self.snapshot.graph);
        match update {
            Some(update) => self.send(&ToViewer::ConnectionGraphUpdate(update)),
            None => Ok(()),
        }
    }

    fn send_time(&mut self) -> Result<(), End> {
        match &self.clock {
            Some(clock) => {
                let time = protocol::time(clock.now());
                self.control(frame::binary(&[&time]))
            }
            None => Ok(()),
        }
    }

    /// The domain time at which a message was published.
    fn time_of(&self, published: Instant) -> DomainTime {
        match self.clock.as_ref().and_then(Clock::reading) {
            Some(reading) => reading.time(published),
            None => {
                let age_ns = sm2_node::now().0.saturating_sub(published.0);
                DomainTime(clock::wall_time().0.saturating_sub(age_ns))
            }
        }
    }

    fn send(&mut self, message: &ToViewer<'_>) -> Result<(), End> {
        // All of its keys are texts, so it has a form in JSON.
        let text = serde_json::to_string(message).unwrap_or_default();
        self.control(frame::text(&text))
    }

    fn control(&mut self, frame: Frame) -> Result<(), End> {
        Ok(self.outbox.control(frame).map_err(Gone::from)?)
    }

    /// Tells the person at the viewer that something is wrong.
    fn complain(&mut self, level: Level, message: String) -> Result<(), End> {
        self.send(&ToViewer::Status { level, message })
    }
}

/// A descriptor that the wait set and the viewer share.
struct Descriptor<T>(Arc<T>);

impl<T: std::os::fd::AsFd> std::os::fd::AsFd for Descriptor<T> {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.0.as_fd()
    }
}
