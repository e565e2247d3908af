//! Errors of inputs.

use std::io;

use sm2_proto::Name;
use sm2_proto::lockstep::IllegalTurn;

use crate::executor::{Failure, WithCauses};
use crate::{DeclareError, RecvError};

/// Inputs ended without a shutdown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InputsError {
    /// The client of the lockstep or the subscriber of the clock cannot be declared.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// A callback returned this error.
    #[error("a callback failed: {}", WithCauses(&**.0))]
    Callback(Failure),
    /// A message cannot be received.
    #[error(transparent)]
    Receive(RecvError),
    /// Messages were lost in lockstep, so the outputs would depend on the speed of the processes.
    #[error(
        "{lost} of node {publisher} on topic {topic} were lost in lockstep: raise the depth of the subscriber, \
         or make it reliable",
        lost = sm2_proto::text::Counted::new(*lost, "message")
    )]
    Lost {
        /// The topic.
        topic: Name,
        /// The publisher's node.
        publisher: Name,
        /// The number of messages.
        lost: u64,
    },
    /// A message came after its turn: its publisher sent more messages in that turn than the
    /// subscriber has room for.
    #[error(
        "a message of node {publisher} on topic {topic} came after its turn in the lockstep: raise depth and \
         max_borrowed of the subscriber above the number of messages of one turn"
    )]
    Late {
        /// The topic.
        topic: Name,
        /// The publisher's node.
        publisher: Name,
    },
    /// The conductor broke the protocol.
    #[error(transparent)]
    IllegalTurn(#[from] IllegalTurn),
    /// Waiting failed.
    #[error("the inputs cannot be waited for: {0}")]
    Io(io::Error),
}
