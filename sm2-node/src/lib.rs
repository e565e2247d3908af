//! SM2 nodes: the library that robot programs use.
//!
//! A *node* is a program's session with the Manager of a *domain*. It publishes and
//! subscribes to *topics*, and serves and calls *services*. The Manager introduces nodes
//! to each other; messages go from node to node through shared memory and never pass it.
//!
//! A publisher:
//!
//! ```no_run
//! # use std::time::Duration;
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = sm2_node::Node::new("talker")?;
//! let publisher = node.publisher::<str>("chatter")?;
//! publisher.wait_for_subscribers_timeout(1, Duration::from_secs(5))?;
//! publisher.publish("hello")?;
//! # Ok(())
//! # }
//! ```
//!
//! A subscriber:
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = sm2_node::Node::new("listener")?;
//! let subscriber = node.subscriber::<str>("chatter")?;
//! let sample = subscriber.recv()?;
//! println!("{}: {}", sample.publisher(), &*sample);
//! # Ok(())
//! # }
//! ```
//!
//! A service, and a call of it:
//!
//! ```no_run
//! # use std::time::Duration;
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let node = sm2_node::Node::new("adder")?;
//! let server = node.server::<[f64], f64>("sum")?;
//! let request = server.recv()?;
//! let sum = request.iter().sum();
//! request.reply(&sum)?;
//!
//! let client = node.client::<[f64], f64>("sum")?;
//! let sum = client.call_timeout(&[1.0, 2.0], Duration::from_secs(1))?;
//! # Ok(())
//! # }
//! ```
//!
//! # What can be sent
//!
//! Bytes, text, numbers, plain old data that is read in place, and whatever serde can
//! encode: see [`Message`]. Two programs talk only if they mean the same type; the first
//! that declares another one gets a [`DeclareError::TypeMismatch`] that names both.
//!
//! # How it moves
//!
//! The library is synchronous and has no hidden threads. Every call of any handle of a node
//! first moves all of the node's sockets on, as far as is possible without waiting; calls
//! that wait move it on while they wait. No call waits for one particular peer, unless that is
//! what it was asked for. [`Node::spin`] is for programs that have nothing to call.
//!
//! # In an event loop of your own
//!
//! A node fits into every loop that can wait until a descriptor is readable. Each of these
//! implements `AsFd`, and each stands for its whole node:
//!
//! | for a | watch | and when it is readable, call |
//! | --- | --- | --- |
//! | [`Subscriber`] | it | [`Subscriber::try_recv`] |
//! | [`Server`] | it | [`Server::try_recv`] |
//! | [`Client`] | it, as long as calls are under way | [`Call::try_wait`] of all of them |
//! | none of these, at the time | the [`Node`] | [`Node::spin_some`] |
//!
//! - Each of these calls first moves the whole node on: no other is needed.
//! - A descriptor stays readable until its call has said that there is nothing, whichever
//!   call read the message from its socket (a publication may do that): a turn may
//!   take one message, or all.
//! - Watch level-triggered. Where a loop only reports what is new (mio, multishot requests of
//!   io_uring), register the descriptor anew after each turn.
//! - No timer is needed: the times that the node itself keeps are behind the same descriptors.
//!   Only the deadline of a call that nobody answers is seen when it is asked for.
//! - Only [`Publisher::publish`] can wait: for reliable subscribers, for at most the
//!   [`PublisherBuilder::publish_timeout`]. A loop that must not wait sets `Duration::ZERO`.
//!
//! The examples `loop_epoll`, `loop_mio` and `loop_io_uring` are complete programs.
//!
//! # When the Manager goes
//!
//! Nothing happens to messages: links go on. The node looks for another Manager by itself, and
//! that one learns from it what it has: see [`Node`]. A domain that needs no daemon is
//! one whose nodes bring a Manager along (`NodeBuilder::embed_manager`, feature
//! `embedded-manager`).
//!
//! # Looking at the domain
//!
//! [`Node::snapshot`] gives all of it, [`Node::watch`] what changes, [`Publisher::why`] and its
//! likes why an interface has no links, [`Node::inspect`] what another node counts.
//!
//! # Conventions
//!
//! *Waiting.* Each operation that waits exists in up to three forms, named as in the standard
//! library and in crossbeam:
//!
//! | form | waits |
//! | --- | --- |
//! | `recv()`, `wait_for_subscribers(n)`, `call(..)`, `spin_once()` | without a time limit |
//! | `recv_timeout(d)`, `wait_for_subscribers_timeout(n, d)`, `call_timeout(.., d)`, `spin_once_timeout(d)` | for at most `d`, a `Duration` |
//! | `try_recv()`, `try_wait()`, and [`Node::spin_some`] | never |
//!
//! A time limit is never an `Option`. A call that finds nothing before its time limit returns `None`,
//! an empty collection, 0 or `false`; an error says that a condition which the program asked for
//! (enough links, a reply, a Manager) did not come about. [`Publisher::publish`] has one form,
//! because only reliable subscribers can make it wait: its time limit is a property of the publisher.
//!
//! *Builders.* `node.publisher("topic")` declares with the defaults; `node.publisher_builder("topic")`
//! gives a builder, which [`declare`](PublisherBuilder::declare) spends. Each setter takes one
//! value, booleans included (`reliable(true)`), so that a value from a configuration passes straight
//! through, and has the same name and type wherever it occurs. A time limit is a `Duration`, and its
//! setter ends in `_timeout`. A setter without a value selects an alternative (`any_type()`).
//! Counts are counts of messages, lengths are in bytes.
//!
//! *Names.* Publisher and subscriber belong to a topic, server and client to a service. Where they
//! do the same, they call it the same: `links`, `matched`, `is_registered`, `why`, `wait_for_…`.
//!
//! *Errors.* One enumeration for each operation, such as [`PublishError`]; its `Io` variant is what the operating
//! system refused. Nothing panics on what another process sends.
//!
//! # How a message travels
//!
//! | form | which messages | costs |
//! | --- | --- | --- |
//! | inline | up to `inline_max` bytes, unless by a ring | a copy for each receiver |
//! | pooled | longer ones, and all by a ring | one copy into a slot that all receivers read; none for a [`Loan`] |
//! | sealed | longer ones, if publisher, subscriber or the domain's policy say so | new memory for each message, which nobody can change any more |
//!
//! | lane | which links | costs |
//! | --- | --- | --- |
//! | ring | topics and services between two nodes that both [offer](NodeBuilder::ring_lane) it, unless sealed | two atomic words; no system call as long as nobody sleeps ([`Wait`]), but a look at the sockets every 100 us |
//! | socket | all others | a system call at each side |
//!
//! # Where to read on
//!
//! [`Node`], [`Publisher`], [`Subscriber`], [`Server`], [`Client`] and their builders;
//! [`mod@domain`] and [`diagnostics`] for tools; the examples; `SPEC.md` for the protocol, whose clauses are named here as `SM2-QOS-002`.
#![deny(unsafe_code)]
#![deny(clippy::disallowed_types)]

// For the derive macros, which speak of `::sm2_node`.
extern crate self as sm2_node;

#[cfg(feature = "tokio")]
pub mod asynchronous;
mod buffer;
mod builder;
mod client;
pub mod diagnostics;
pub mod domain;
mod driver;
pub mod encoding;
mod error;
mod handle;
mod loan;
mod message;
mod node;
mod payload;
mod plain;
mod pool;
#[allow(
    unsafe_code,
    reason = "the one constructor of a slice over pooled memory"
)]
mod pooled;
mod published;
mod publisher;
mod sample;
pub mod schema;
mod server;
mod spare;
mod subscriber;
mod wait;

pub use builder::NodeBuilder;
pub use client::{Call, Client, ClientBuilder, Reply};
pub use error::{
    CallError, ConnectError, DeclareError, PublishError, RecvError, ReplyError, StoreError,
    WaitError,
};
pub use loan::Loan;
pub use message::{EncodeError, Message, PayloadError};
pub use node::Node;
pub use payload::Payload;
pub use plain::{InPlace, Plain};
pub use published::Published;
pub use publisher::{Publisher, PublisherBuilder};
pub use sample::Sample;
pub use schema::Schema;
pub use server::{Request, Server, ServerBuilder};
pub use sm2_io::clock::now;
pub use sm2_node_derive::{Message, Schema};
pub use sm2_proto::{Instant, Name, NameError, TypeId};
pub use subscriber::{Subscriber, SubscriberBuilder};
pub use wait::Wait;
pub use {serde, zerocopy};
