//! The inputs and outputs of a connection.

use quinn_proto::{ConnectionEvent, EndpointEvent};

use super::{command::Command, event::Event};

/// An input of a [`Peer`](super::Peer).
#[derive(Debug)]
pub enum Input {
    /// An event of the QUIC endpoint, such as a datagram.
    Quic(ConnectionEvent),
    /// A command of the hub.
    Command(Command),
    /// Time has passed.
    Tick,
}

/// An output of a [`Peer`](super::Peer).
#[derive(Debug)]
pub enum Output {
    /// An event for the hub, or for the task of the connection.
    Event(Event),
    /// An event for the QUIC endpoint. Its answer, if any, is the next [`Input::Quic`].
    Endpoint(EndpointEvent),
}
