//! A domain, a server, and a viewer.

use std::collections::{BTreeMap, VecDeque};
use std::net::TcpStream;
use std::thread::{self, JoinHandle};

use foxglove::ws_protocol::client::{Subscribe, Subscription};
use foxglove::ws_protocol::server::advertise_services::Service;
use foxglove::ws_protocol::server::{Channel, MessageData, ServerInfo, ServerMessage};
use serde::{Deserialize, Serialize};
use sm2_foxglove::{Options, Server};
use sm2_manager::Background;
use sm2_node::domain::Contract;
use sm2_node::{Message, Node, Shutdown};
use sm2_test_support::{SOON, until};
use tempfile::TempDir;
use tungstenite::client::IntoClientRequest;
use tungstenite::handshake::client::Request;
use tungstenite::http::header::{HeaderName, HeaderValue, SEC_WEBSOCKET_PROTOCOL};
use tungstenite::{Message as Frame, WebSocket};

/// A message of a serde type.
#[derive(Clone, Debug, PartialEq, Message, Serialize, Deserialize)]
#[message(name = "Pose", encoding = "postcard")]
pub(crate) struct Pose {
    pub(crate) frame: String,
    pub(crate) x: f64,
    pub(crate) tags: Vec<u32>,
}

/// A message that travels as JSON.
#[derive(Clone, Debug, PartialEq, Message, Serialize, Deserialize)]
#[message(name = "Report", encoding = "json")]
pub(crate) struct Report {
    pub(crate) text: String,
    pub(crate) level: u8,
}

/// A domain.
pub(crate) struct World {
    manager: Option<Background>,
    folder: TempDir,
}

impl World {
    pub(crate) fn new() -> Self {
        let mut world = Self {
            manager: None,
            folder: TempDir::new().unwrap(),
        };
        world.start_manager();
        world
    }

    pub(crate) fn start_manager(&mut self) {
        let options = sm2_manager::Options::default();
        self.manager = Some(Background::start(&self.socket(), options).unwrap());
    }

    pub(crate) fn end_manager(&mut self) {
        self.manager = None;
    }

    pub(crate) fn socket(&self) -> std::path::PathBuf {
        self.folder.path().join("sock")
    }

    pub(crate) fn node(&self, name: &str) -> Node {
        Node::builder(name).socket(self.socket()).connect().unwrap()
    }

    pub(crate) fn foxglove(&self, options: Options) -> Running {
        let node = self.node("foxglove");
        let mut server = Server::start(&node, options).unwrap();
        let url = server.url();
        let shutdown = Shutdown::new().unwrap();
        let requested = shutdown.clone();
        let thread = thread::spawn(move || server.run(&requested).unwrap());
        Running {
            url,
            shutdown,
            thread: Some(thread),
        }
    }
}

/// The subscribers of a topic, as the domain sees them.
pub(crate) fn subscribers(node: &Node, name: &str) -> usize {
    let domain = node.snapshot().unwrap();
    let is_one =
        |it: &Contract| matches!(it, Contract::Subscriber { topic, .. } if topic.as_str() == name);
    domain.interfaces().filter(|it| is_one(it.contract)).count()
}

/// A server in a thread.
pub(crate) struct Running {
    pub(crate) url: String,
    shutdown: Shutdown,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    /// Ends the server.
    pub(crate) fn end(&mut self) {
        self.shutdown.request();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.shutdown.request();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The request of a viewer.
pub(crate) fn request(url: &str, headers: &[(HeaderName, &str)]) -> Request {
    let mut request = url.into_client_request().unwrap();
    let own = [(SEC_WEBSOCKET_PROTOCOL, "foxglove.sdk.v1")];
    for (name, value) in own.iter().chain(headers) {
        let value = HeaderValue::from_str(value).unwrap();
        request.headers_mut().insert(name, value);
    }
    request
}

/// The address of a URL such as `ws://127.0.0.1:8765/TOKEN`.
pub(crate) fn address(url: &str) -> &str {
    url.strip_prefix("ws://")
        .unwrap()
        .split_once('/')
        .unwrap()
        .0
}

/// A viewer.
pub(crate) struct Viewer {
    socket: WebSocket<TcpStream>,
    /// The first message of the server.
    pub(crate) info: ServerInfo,
    /// The channels and services that exist, by their names.
    channels: BTreeMap<String, Channel<'static>>,
    services: BTreeMap<String, Service<'static>>,
    /// Messages that were read, and not asked for yet.
    read: VecDeque<ServerMessage<'static>>,
    subscriptions: u32,
}

impl Viewer {
    pub(crate) fn connect(url: &str) -> Self {
        Self::over(TcpStream::connect(address(url)).unwrap(), url)
    }

    /// A viewer over a connection to the server at `url`.
    pub(crate) fn over(tcp: TcpStream, url: &str) -> Self {
        tcp.set_read_timeout(Some(SOON)).unwrap();
        let (socket, response) = tungstenite::client(request(url, &[]), tcp).unwrap();
        let subprotocol = response.headers().get(SEC_WEBSOCKET_PROTOCOL).unwrap();
        assert_eq!(subprotocol, "foxglove.sdk.v1");
        let mut viewer = Self {
            socket,
            info: ServerInfo::new(""),
            channels: BTreeMap::new(),
            services: BTreeMap::new(),
            read: VecDeque::new(),
            subscriptions: 0,
        };
        match viewer.receive() {
            ServerMessage::ServerInfo(info) => viewer.info = info,
            other => panic!("the first message is {other:?}"),
        }
        viewer
    }

    pub(crate) fn send(&mut self, message: impl Into<Frame>) {
        self.socket.send(message.into()).unwrap();
    }

    /// The next frame of the server.
    pub(crate) fn frame(&mut self) -> tungstenite::Result<Frame> {
        self.socket.read()
    }

    fn receive(&mut self) -> ServerMessage<'static> {
        loop {
            let frame = self.socket.read().unwrap();
            if !frame.is_text() && !frame.is_binary() {
                continue;
            }
            let message = ServerMessage::try_from(&frame).unwrap().into_owned();
            match &message {
                ServerMessage::Advertise(it) => {
                    for channel in &it.channels {
                        self.channels
                            .insert(channel.topic.to_string(), channel.clone());
                    }
                }
                ServerMessage::Unadvertise(it) => {
                    let gone = &it.channel_ids;
                    self.channels
                        .retain(|_, channel| !gone.contains(&channel.id));
                }
                ServerMessage::AdvertiseServices(it) => {
                    for service in &it.services {
                        self.services
                            .insert(service.name.to_string(), service.clone());
                    }
                }
                ServerMessage::UnadvertiseServices(it) => {
                    let gone = &it.service_ids;
                    self.services
                        .retain(|_, service| !gone.contains(&service.id));
                }
                _ => {}
            }
            return message;
        }
    }

    /// The first message that `find` has an answer for. Other messages stay for later questions.
    pub(crate) fn wait<T>(&mut self, mut find: impl FnMut(&ServerMessage<'_>) -> Option<T>) -> T {
        for at in 0..self.read.len() {
            if let Some(found) = find(&self.read[at]) {
                self.read.remove(at);
                return found;
            }
        }
        loop {
            let message = self.receive();
            if let Some(found) = find(&message) {
                return found;
            }
            self.read.push_back(message);
        }
    }

    /// The channel of a topic, once it exists.
    pub(crate) fn channel(&mut self, topic: &str) -> Channel<'static> {
        while !self.channels.contains_key(topic) {
            let message = self.receive();
            self.read.push_back(message);
        }
        self.channels[topic].clone()
    }

    /// Returns once a topic has no channel.
    pub(crate) fn no_channel(&mut self, topic: &str) {
        while self.channels.contains_key(topic) {
            let message = self.receive();
            self.read.push_back(message);
        }
    }

    /// The names of all channels.
    pub(crate) fn topics(&self) -> Vec<&str> {
        self.channels.keys().map(String::as_str).collect()
    }

    /// A service, once it exists.
    pub(crate) fn service(&mut self, name: &str) -> Service<'static> {
        while !self.services.contains_key(name) {
            let message = self.receive();
            self.read.push_back(message);
        }
        self.services[name].clone()
    }

    /// Returns once a service does not exist.
    pub(crate) fn no_service(&mut self, name: &str) {
        while self.services.contains_key(name) {
            let message = self.receive();
            self.read.push_back(message);
        }
    }

    /// Subscribes to a topic, once it exists. Returns the number of the subscription.
    pub(crate) fn subscribe(&mut self, topic: &str) -> u32 {
        let channel = self.channel(topic);
        self.subscriptions += 1;
        let id = self.subscriptions;
        self.send(&Subscribe::new([Subscription::new(id, channel.id)]));
        id
    }

    /// The next message of a subscription.
    pub(crate) fn message(&mut self, subscription: u32) -> MessageData<'static> {
        self.wait(|message| match message {
            ServerMessage::MessageData(it) if it.subscription_id == subscription => {
                Some(it.clone().into_owned())
            }
            _ => None,
        })
    }

    /// The text of the next status.
    pub(crate) fn status(&mut self) -> String {
        self.wait(|message| match message {
            ServerMessage::Status(status) => Some(status.message.clone()),
            _ => None,
        })
    }
}

/// Returns once a topic has this many subscribers.
pub(crate) fn until_subscribers(node: &Node, topic: &str, count: usize) {
    until(&format!("{count} subscribers"), || {
        subscribers(node, topic) == count
    });
}
