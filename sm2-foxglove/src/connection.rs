//! The connection to a viewer: the handshake, and a socket that never blocks.

use std::{
    cell::Cell,
    io::{self, Read, Write},
    net::{Shutdown, TcpStream},
    sync::Arc,
    time::{Duration, Instant},
};

use socket2::SockRef;
use tungstenite::{
    Error, HandshakeError, Message, WebSocket,
    handshake::server::{ErrorResponse, Request, Response},
    http::{HeaderValue, StatusCode, header::SEC_WEBSOCKET_PROTOCOL},
    protocol::WebSocketConfig,
};

use crate::{
    access::{Access, Refused},
    outbox::{Frame, Outbox, Unread},
    protocol::SUBPROTOCOLS,
};

/// A client that has not asked for a connection after this time is disconnected.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// The longest message of a viewer, in bytes.
const READ_MAX: usize = 16 * 1024 * 1024;

/// The kernel takes no more bytes while so many are not sent yet. Otherwise it would take megabytes of messages, which
/// are old when a slow link has carried them.
const UNSENT_BYTES_MAX: u32 = 64 * 1024;

/// The connection to a viewer.
pub(crate) struct Connection {
    socket: WebSocket<Stream>,
    /// The frame that is being written, and how many of its bytes have left.
    current: Option<(Frame, usize)>,
}

/// The reason why a client does not become a viewer.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AcceptError {
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error("refused: the client speaks none of the subprotocols {}", SUBPROTOCOLS.join(", "))]
    Subprotocol,
    #[error("no handshake of the WebSocket protocol: {0}")]
    Handshake(Box<Error>),
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// The reason for the end of a connection.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Gone {
    #[error("it closed the connection")]
    Closed,
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("it broke the protocol: {0}")]
    Protocol(Box<Error>),
    #[error("it does not read")]
    Unread,
}

impl From<Unread> for Gone {
    fn from(Unread: Unread) -> Self {
        Self::Unread
    }
}

impl Connection {
    /// Performs the handshake, and checks whether the client may connect.
    ///
    /// # Errors
    ///
    /// See [`AcceptError`]. A client that may not connect gets the reason in the response.
    pub(crate) fn accept(tcp: Arc<TcpStream>, access: &Access) -> Result<Self, AcceptError> {
        tcp.set_nodelay(true)?;
        tcp.set_write_timeout(Some(HANDSHAKE_TIMEOUT))?;
        SockRef::from(&*tcp).set_tcp_notsent_lowat(UNSENT_BYTES_MAX)?;
        let stream = Stream {
            tcp,
            phase: Phase::Handshake(Instant::now() + HANDSHAKE_TIMEOUT),
        };
        let refused = Cell::new(None);
        let config = WebSocketConfig::default()
            .max_message_size(Some(READ_MAX))
            .max_frame_size(Some(READ_MAX))
            .read_buffer_size(16 * 1024)
            .write_buffer_size(0);
        #[expect(clippy::result_large_err, reason = "the signature of tungstenite")]
        let check = |request: &Request, response: Response| {
            answer(access, request, response).map_err(|error| {
                let response = error.response();
                refused.set(Some(error));
                response
            })
        };
        let socket = tungstenite::accept_hdr_with_config(stream, check, Some(config));
        let mut socket = socket.map_err(|error| match (refused.take(), error) {
            (Some(refused), _) => refused,
            (None, HandshakeError::Failure(error)) => AcceptError::Handshake(error.into()),
            // The socket blocks, so this is a timeout.
            (None, HandshakeError::Interrupted(_)) => {
                io::Error::from(io::ErrorKind::TimedOut).into()
            }
        })?;
        let stream = socket.get_mut();
        stream.tcp.set_nonblocking(true)?;
        stream.phase = Phase::Open {
            answers: Vec::new(),
        };
        Ok(Self {
            socket,
            current: None,
        })
    }

    /// The next message of the viewer, if one has arrived. Answers to pings go to `outbox`.
    ///
    /// # Errors
    ///
    /// See [`Gone`].
    pub(crate) fn read(&mut self, outbox: &mut Outbox) -> Result<Option<Message>, Gone> {
        let result = self.socket.read();
        // Writes the answer to a control frame, which is not always due at once. The next read reports errors.
        let _ = self.socket.flush();
        if let Phase::Open { answers } = &mut self.socket.get_mut().phase
            && !answers.is_empty()
        {
            outbox.control(std::mem::take(answers))?;
        }
        match result {
            Ok(Message::Close(_)) => {
                // The answer goes out if the socket takes it.
                let _ = self.write(outbox);
                Err(Gone::Closed)
            }
            Ok(message) => Ok(Some(message)),
            Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(Error::Io(error)) => Err(error.into()),
            Err(Error::ConnectionClosed | Error::AlreadyClosed) => Err(Gone::Closed),
            Err(error) => Err(Gone::Protocol(error.into())),
        }
    }

    /// Writes what the socket takes. Returns whether there is more.
    ///
    /// # Errors
    ///
    /// See [`Gone`].
    pub(crate) fn write(&mut self, outbox: &mut Outbox) -> Result<bool, Gone> {
        loop {
            let (frame, written) = match &mut self.current {
                Some(current) => current,
                None => match outbox.pop() {
                    Some(frame) => self.current.insert((frame, 0)),
                    None => return Ok(false),
                },
            };
            match (&*self.socket.get_ref().tcp).write(&frame[*written..]) {
                Ok(0) => return Err(Gone::Closed),
                Ok(len) => *written += len,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(true),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
            if *written == frame.len() {
                self.current = None;
                outbox.written();
            }
        }
    }

    /// Ends the connection with a status code of the protocol, if the socket takes the frame.
    pub(crate) fn close(mut self, mut outbox: Outbox, code: u16) {
        let mut frame = vec![0x88, 2];
        frame.extend(code.to_be_bytes());
        if outbox.control(frame).is_ok() {
            let _ = self.write(&mut outbox);
        }
        let _ = self.socket.get_ref().tcp.shutdown(Shutdown::Write);
    }
}

impl AcceptError {
    /// The response that refuses a client.
    fn response(&self) -> ErrorResponse {
        let mut response = ErrorResponse::new(Some(format!("{self}\n")));
        *response.status_mut() = match self {
            Self::Refused(_) => StatusCode::FORBIDDEN,
            Self::Subprotocol | Self::Handshake(_) | Self::Io(_) => StatusCode::BAD_REQUEST,
        };
        response
    }
}

/// Answers a request for a connection.
fn answer(
    access: &Access,
    request: &Request,
    mut response: Response,
) -> Result<Response, AcceptError> {
    access.check(request.headers(), request.uri())?;
    let offered = request.headers().get_all(SEC_WEBSOCKET_PROTOCOL);
    let offered = offered.iter().filter_map(|it| it.to_str().ok());
    let offered: Vec<_> = offered
        .flat_map(|it| it.split(','))
        .map(str::trim)
        .collect();
    let spoken = SUBPROTOCOLS.into_iter().find(|it| offered.contains(it));
    let spoken = HeaderValue::from_static(spoken.ok_or(AcceptError::Subprotocol)?);
    response
        .headers_mut()
        .insert(SEC_WEBSOCKET_PROTOCOL, spoken);
    Ok(response)
}

/// The stream below `tungstenite`.
struct Stream {
    tcp: Arc<TcpStream>,
    phase: Phase,
}

enum Phase {
    /// The socket blocks, until this time.
    Handshake(Instant),
    /// The answers of `tungstenite` to control frames, which are frames of the outbox like all others.
    Open { answers: Vec<u8> },
}

impl Read for Stream {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if let Phase::Handshake(deadline) = self.phase {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(io::ErrorKind::TimedOut.into());
            }
            self.tcp.set_read_timeout(Some(left))?;
        }
        (&*self.tcp).read(buffer)
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.phase {
            Phase::Handshake(_) => (&*self.tcp).write(bytes),
            Phase::Open { answers } => answers.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
