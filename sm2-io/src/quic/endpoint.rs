//! All connections of one gateway: assigns datagrams to connections.

use std::{net::SocketAddr, sync::Arc, time::Instant};

use bytes::BytesMut;
use quinn_proto::{
    ClientConfig, Connection, ConnectionEvent, ConnectionHandle, DatagramEvent, EcnCodepoint,
    EndpointConfig, EndpointEvent, ServerConfig, Transmit, TransportConfig,
};
use rustls::pki_types::CertificateDer;
use sm2_proto::gateway::GatewayId;

use super::{Congestion, SecretKey, Trusted, key::from_spki, tls, transport};

/// The most incoming handshakes in flight.
const HANDSHAKES_MAX: usize = 64;

/// The connections of one gateway. Does no I/O.
#[derive(Debug)]
pub struct Endpoint {
    quic: quinn_proto::Endpoint,
    key: SecretKey,
    trusted: Trusted,
    transport: Arc<TransportConfig>,
}

/// The result of a received datagram.
#[derive(Debug)]
pub enum Arrival {
    /// A peer opens a connection.
    New(ConnectionHandle, Box<Connection>),
    /// The datagram belongs to this connection.
    Event(ConnectionHandle, ConnectionEvent),
    /// The bytes in the buffer have to be sent in answer.
    Answer(Transmit),
}

impl Endpoint {
    /// Creates the endpoint of the gateway with this key. Tests pass a `seed` to be repeatable.
    ///
    /// # Errors
    /// TLS rejects the key.
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

    /// Opens a connection to `address`, which fails unless `peer` answers there.
    ///
    /// # Errors
    /// The address is not valid for this socket, or there are too many connections.
    pub fn connect(
        &mut self,
        now: Instant,
        peer: GatewayId,
        address: SocketAddr,
    ) -> Result<(ConnectionHandle, Connection), String> {
        let crypto = tls::client(&self.key, peer, &self.trusted).map_err(|it| it.to_string())?;
        let mut config = ClientConfig::new(Arc::new(crypto));
        config.transport_config(Arc::clone(&self.transport));
        // The verifier ignores the name: the key identifies the peer.
        let connected = self.quic.connect(now, config, address, "gateway.invalid");
        connected.map_err(|error| error.to_string())
    }

    /// Refuses new connections from peers.
    pub fn close(&mut self) {
        self.quic.set_server_config(None);
    }

    /// Handles a received datagram. Writes the bytes of an answer into `buffer`.
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

    /// Handles an event from a connection. Returns the event for the connection that follows.
    pub fn event(
        &mut self,
        handle: ConnectionHandle,
        event: EndpointEvent,
    ) -> Option<ConnectionEvent> {
        self.quic.handle_event(handle, event)
    }
}

/// The gateway at the other end, once the handshake has completed.
#[must_use]
pub fn peer_of(connection: &Connection) -> Option<GatewayId> {
    let identity = connection.crypto_session().peer_identity()?;
    let shown = identity.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    from_spki(shown.first()?)
}
