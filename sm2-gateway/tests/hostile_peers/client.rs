//! A QUIC client written by hand, which can send anything.

use std::{
    collections::BTreeMap,
    net::{SocketAddr, UdpSocket},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use bytes::{Bytes, BytesMut};
use quinn_proto::{
    Connection, ConnectionError, ConnectionHandle, DatagramEvent, Dir, Endpoint, EndpointConfig,
    Event, ReadError, StreamEvent, StreamId, TransportConfig, VarInt, WriteError,
};
use sm2_proto::{
    Name,
    gateway::{AskId, Frame, FrameReader, Header, SubjectKind},
};

use sm2_test_support::SOON;

/// The time between two looks for datagrams.
const MOMENT: Duration = Duration::from_micros(200);

pub(crate) struct Client {
    socket: UdpSocket,
    endpoint: Endpoint,
    handle: ConnectionHandle,
    connection: Connection,
    pub(crate) is_connected: bool,
    /// True if the client has stopped reading.
    pub(crate) is_deaf: bool,
    pub(crate) lost: Option<ConnectionError>,
    pub(crate) control: Option<StreamId>,
    /// The bytes of the control stream.
    reader: FrameReader,
    pub(crate) frames: Vec<Frame>,
    /// The number of the last question that [`round_trip`](Self::round_trip) has asked.
    asked: AskId,
    /// Streams that the other side has stopped reading, with its error code.
    pub(crate) stopped: BTreeMap<StreamId, u64>,
    /// The bytes of other streams, and how each stream has ended.
    pub(crate) came: BTreeMap<StreamId, (Vec<u8>, Option<Ending>)>,
}

/// How a stream ended: `Ok` if finished, or the code of its reset.
type Ending = Result<(), u64>;

impl Client {
    pub(crate) fn dial(
        to: SocketAddr,
        tls: rustls::ClientConfig,
        transport: TransportConfig,
    ) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        let mut endpoint = Endpoint::new(Arc::new(EndpointConfig::default()), None, true, None);
        let tls = quinn_proto::crypto::rustls::QuicClientConfig::try_from(tls).unwrap();
        let mut config = quinn_proto::ClientConfig::new(Arc::new(tls));
        config.transport_config(Arc::new(transport));
        let connected = endpoint.connect(Instant::now(), config, to, "gateway.invalid");
        let (handle, connection) = connected.unwrap();
        Self {
            socket,
            endpoint,
            handle,
            connection,
            is_connected: false,
            is_deaf: false,
            lost: None,
            control: None,
            reader: FrameReader::default(),
            frames: Vec::new(),
            asked: AskId(1 << 32),
            stopped: BTreeMap::new(),
            came: BTreeMap::new(),
        }
    }

    /// Waits until the condition is true.
    pub(crate) fn until(&mut self, what: &str, mut is_so: impl FnMut(&mut Self) -> bool) {
        let deadline = Instant::now() + SOON;
        while !is_so(self) {
            let frames = &self.frames;
            assert!(
                Instant::now() < deadline,
                "{what}: not in time; {:?} {frames:?}",
                self.lost
            );
            self.wait();
        }
    }

    /// Waits until the other side has handled everything that was sent before: it has answered a question.
    pub(crate) fn round_trip(&mut self) {
        self.ask();
        self.until("the answer", Self::is_answered);
    }

    /// Asks a question.
    pub(crate) fn ask(&mut self) {
        self.asked.0 += 1;
        let name = Name::new("round-trip").unwrap();
        let (ask, kind) = (self.asked, SubjectKind::Topic);
        self.frame(&Frame::Ask { ask, kind, name });
    }

    /// True if the last question was answered.
    pub(crate) fn is_answered(&mut self) -> bool {
        let mut frames = self.frames.iter();
        frames.any(|it| matches!(it, Frame::Answer { ask, .. } if *ask == self.asked))
    }

    /// Waits until the connection and its control stream are open.
    pub(crate) fn connected(mut self) -> Self {
        self.until("the handshake", |it| it.is_connected || it.lost.is_some());
        assert!(self.lost.is_none(), "{:?}", self.lost);
        self.control = self.connection.streams().open(Dir::Bi);
        self
    }

    pub(crate) fn say(&mut self, bytes: &[u8]) {
        let control = self.control.unwrap();
        self.write_all(control, bytes);
    }

    pub(crate) fn frame(&mut self, frame: &Frame) {
        self.say(&frame.to_bytes());
    }

    /// Opens a stream, as soon as the other side allows one more.
    pub(crate) fn open(&mut self, dir: Dir) -> StreamId {
        let mut opened = None;
        self.until("room for a stream", |it| {
            opened = it.connection.streams().open(dir);
            opened.is_some()
        });
        opened.unwrap()
    }

    /// Writes as many bytes as flow control allows.
    pub(crate) fn write(&mut self, id: StreamId, mut bytes: &[u8]) {
        while !bytes.is_empty() && self.lost.is_none() {
            match self.connection.send_stream(id).write(bytes) {
                Ok(len) => bytes = &bytes[len..],
                Err(_) => return,
            }
            self.turn();
        }
    }

    /// Writes all bytes, unless the other side stops reading.
    pub(crate) fn write_all(&mut self, id: StreamId, mut bytes: &[u8]) {
        while !bytes.is_empty() && self.lost.is_none() {
            match self.connection.send_stream(id).write(bytes) {
                Ok(len) => bytes = &bytes[len..],
                Err(WriteError::Blocked) => self.wait(),
                Err(_) => return,
            }
            self.turn();
        }
    }

    pub(crate) fn finish(&mut self, id: StreamId) {
        let _ = self.connection.send_stream(id).finish();
    }

    /// Opens a stream, and sends a header and a payload on it.
    pub(crate) fn send(&mut self, dir: Dir, header: &Header, payload: &[u8]) -> StreamId {
        let id = self.open(dir);
        self.write(id, &header.to_bytes());
        self.write(id, payload);
        self.finish(id);
        id
    }

    pub(crate) fn give_up_sending(&mut self, id: StreamId) {
        let _ = self.connection.send_stream(id).reset(VarInt::from_u32(115));
    }

    pub(crate) fn give_up(&mut self, id: StreamId) {
        let code = VarInt::from_u32(115);
        let _ = self.connection.send_stream(id).reset(code);
        let _ = self.connection.recv_stream(id).stop(code);
    }

    pub(crate) fn datagram(&mut self, bytes: &[u8]) {
        let bytes = Bytes::copy_from_slice(bytes);
        self.connection.datagrams().send(bytes, true).unwrap();
    }

    /// Waits until the other side closes the connection. Returns its error code.
    pub(crate) fn closed(&mut self, what: &str) -> u64 {
        self.until(what, |it| it.lost.is_some());
        match self.lost.clone() {
            Some(ConnectionError::ApplicationClosed(close)) => close.error_code.into_inner(),
            other => panic!("{what}: {other:?}"),
        }
    }

    /// Sends and receives datagrams, and sleeps a moment if nothing was there.
    fn wait(&mut self) {
        if !self.turn() {
            thread::sleep(MOMENT);
        }
    }

    /// Sends and receives datagrams. True if one has arrived.
    pub(crate) fn turn(&mut self) -> bool {
        let mut buffer = Vec::new();
        while let Some(transmit) = (self.connection).poll_transmit(Instant::now(), 1, &mut buffer) {
            let _ = self
                .socket
                .send_to(&buffer[..transmit.size], transmit.destination);
            buffer.clear();
        }
        let mut bytes = [0; 2_048];
        let received = self.socket.recv_from(&mut bytes).ok();
        if let Some((len, from)) = received {
            let bytes = BytesMut::from(&bytes[..len]);
            let (now, answer) = (Instant::now(), &mut Vec::new());
            if let Some(DatagramEvent::ConnectionEvent(_, event)) =
                self.endpoint.handle(now, from, None, None, bytes, answer)
            {
                self.connection.handle_event(event);
            }
        }
        let now = Instant::now();
        if self.connection.poll_timeout().is_some_and(|it| it <= now) {
            self.connection.handle_timeout(now);
        }
        while let Some(event) = self.connection.poll_endpoint_events() {
            if let Some(event) = self.endpoint.handle_event(self.handle, event) {
                self.connection.handle_event(event);
            }
        }
        while let Some(event) = self.connection.poll() {
            self.event(event);
        }
        received.is_some()
    }

    fn event(&mut self, event: Event) {
        match event {
            Event::Connected => self.is_connected = true,
            Event::ConnectionLost { reason } => self.lost = Some(reason),
            Event::Stream(StreamEvent::Opened { dir }) => {
                while let Some(id) = self.connection.streams().accept(dir) {
                    self.read(id);
                }
            }
            Event::Stream(StreamEvent::Readable { id }) => self.read(id),
            Event::Stream(StreamEvent::Stopped { id, error_code }) => {
                self.stopped.insert(id, error_code.into_inner());
            }
            _ => {}
        }
    }

    fn read(&mut self, id: StreamId) {
        if self.is_deaf {
            return;
        }
        let mut stream = self.connection.recv_stream(id);
        let Ok(mut chunks) = stream.read(true) else {
            return;
        };
        let it = self.came.entry(id).or_default();
        loop {
            match chunks.next(usize::MAX) {
                Ok(Some(chunk)) => it.0.extend_from_slice(&chunk.bytes),
                Ok(None) => it.1 = Some(Ok(())),
                Err(ReadError::Blocked) => break,
                Err(ReadError::Reset(code)) => it.1 = Some(Err(code.into_inner())),
            }
            if it.1.is_some() {
                break;
            }
        }
        let _ = chunks.finalize();
        if self.control == Some(id) {
            self.reader.push(&std::mem::take(&mut it.0));
            while let Some(frame) = self.reader.next_frame().unwrap() {
                self.frames.push(frame);
            }
        }
    }
}
