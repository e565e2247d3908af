//! All connections of one gateway: which datagram is whose.

use std::{net::SocketAddr, sync::Arc, time::Instant};

use bytes::BytesMut;
use quinn_proto::{
    ClientConfig, Connection, ConnectionEvent, ConnectionHandle, DatagramEvent, EcnCodepoint,
    EndpointConfig, EndpointEvent, ServerConfig, Transmit, TransportConfig,
};
use rustls::pki_types::CertificateDer;
use sm2_proto::gateway::GatewayId;

use super::{Congestion, SecretKey, Trusted, key::from_spki, tls, transport};

/// How many handshakes that others began may be under way.
const HANDSHAKES_MAX: usize = 64;

/// The connections of one gateway. Does no I/O.
#[derive(Debug)]
pub struct Endpoint {
    quic: quinn_proto::Endpoint,
    key: SecretKey,
    trusted: Trusted,
    transport: Arc<TransportConfig>,
}

/// What a datagram brought.
#[derive(Debug)]
pub enum Arrival {
    /// Somebody opens a connection.
    New(ConnectionHandle, Box<Connection>),
    /// It is for this connection.
    Event(ConnectionHandle, ConnectionEvent),
    /// It has to be answered, with the bytes in the buffer.
    Answer(Transmit),
}

impl Endpoint {
    /// An endpoint of the gateway that has this key. `seed`: for tests that are to be repeatable.
    ///
    /// # Errors
    /// TLS does not take the key.
    pub fn new(
        key: SecretKey,
        trusted: Trusted,
        congestion: Congestion,
        seed: Option<[u8; 32]>,
    ) -> Result<Self, rustls::Error> {
        let transport = transport::config(congestion);
        let crypto = Arc::new(tls::server(&key, &trusted)?);
        let mut server = ServerConfig::with_crypto(crypto);
        server
            .transport_config(Arc::clone(&transport))
            .max_incoming(HANDSHAKES_MAX);
        let mut config = EndpointConfig::default();
        config.rng_seed(seed);
        let quic = quinn_proto::Endpoint::new(Arc::new(config), Some(Arc::new(server)), true, None);
        Ok(Self {
            quic,
            key,
            trusted,
            transport,
        })
    }

    /// Opens a connection with `peer`, and nobody else, at `address`.
    ///
    /// # Errors
    /// There is no way to such an address, or there are too many connections.
    pub fn connect(
        &mut self,
        now: Instant,
        peer: GatewayId,
        address: SocketAddr,
    ) -> Result<(ConnectionHandle, Connection), String> {
        let crypto = tls::client(&self.key, peer, &self.trusted).map_err(|it| it.to_string())?;
        let mut config = ClientConfig::new(Arc::new(crypto));
        config.transport_config(Arc::clone(&self.transport));
        // Nobody looks at the name: the key says who it is.
        let connected = self.quic.connect(now, config, address, "gateway.invalid");
        connected.map_err(|error| error.to_string())
    }

    /// Takes no more connections that others open.
    pub fn close(&mut self) {
        self.quic.set_server_config(None);
    }

    /// Takes a datagram. What is to be sent in answer is put into `buffer`.
    pub fn handle(
        &mut self,
        now: Instant,
        from: SocketAddr,
        ecn: Option<EcnCodepoint>,
        datagram: &[u8],
        buffer: &mut Vec<u8>,
    ) -> Option<Arrival> {
        let datagram = BytesMut::from(datagram);
        match self.quic.handle(now, from, None, ecn, datagram, buffer)? {
            DatagramEvent::NewConnection(incoming) => {
                match self.quic.accept(incoming, now, buffer, None) {
                    Ok((handle, connection)) => Some(Arrival::New(handle, Box::new(connection))),
                    Err(error) => error.response.map(Arrival::Answer),
                }
            }
            DatagramEvent::ConnectionEvent(handle, event) => Some(Arrival::Event(handle, event)),
            DatagramEvent::Response(transmit) => Some(Arrival::Answer(transmit)),
        }
    }

    /// Takes what a connection says to its endpoint; what the endpoint says to it.
    pub fn event(
        &mut self,
        handle: ConnectionHandle,
        event: EndpointEvent,
    ) -> Option<ConnectionEvent> {
        self.quic.handle_event(handle, event)
    }
}

/// Who is at the other end, once the handshake is done.
#[must_use]
pub fn peer_of(connection: &Connection) -> Option<GatewayId> {
    let identity = connection.crypto_session().peer_identity()?;
    let shown = identity.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    from_spki(shown.first()?)
}
