//! SM2 nodes: the library that robot programs use.
//!
//! A *node* is a program's session with the Manager of a *domain*. It publishes and subscribes to *topics*,
//! and serves and calls *services*. The Manager links the interfaces of nodes; messages go from node to node
//! through shared memory and never through the Manager.
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
//! The server of a service:
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = sm2_node::Node::new("adder")?;
//! let server = node.server::<[f64], f64>("sum")?;
//! loop {
//!     let request = server.recv()?;
//!     let sum = request.iter().sum();
//!     request.reply(&sum)?;
//! }
//! # }
//! ```
//!
//! A client, in another program:
//!
//! ```no_run
//! # use std::time::Duration;
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let node = sm2_node::Node::new("calculator")?;
//! let client = node.client::<[f64], f64>("sum")?;
//! let sum = client.call_timeout(&[1.0, 2.0], Duration::from_secs(1))?;
//! # Ok(())
//! # }
//! ```
//!
//! # What can be sent
//!
//! Bytes, text, numbers, plain old data that is read in place, and every type that serde can encode: see
//! [`Message`]. Two programs can only communicate if they use the same type. A program that declares a topic
//! with another type gets a [`DeclareError::TypeMismatch`], which names both types.
//!
//! # How it runs
//!
//! The work of a node has two sides:
//!
//! | side | done by | work |
//! | --- | --- | --- |
//! | control | a background thread of the node | the session, links that open or end, messages that wait for room |
//! | data | the calls of the program | sending, taking and releasing messages |
//!
//! The background thread sleeps until the control side has work; messages do not wake it. A publisher whose program
//! does something else is therefore found by new subscribers, and the next Manager is found by itself. A call of the
//! data side reads the sockets that are ready without waiting, up to 64 of them and up to 32 datagrams of each. While
//! all links of a publisher, subscriber or service use rings, its calls read the sockets every 100 µs only. A call
//! waits for a particular peer only if its purpose is to do so.
//!
//! The thread is called `sm2:` and the beginning of the node's name. All signals are blocked in it. It inherits the
//! scheduling policy, the priority and the affinity of the thread that connected the node. It holds the lock of an
//! interface for a bounded amount of work, without waiting. The locks have no priority inheritance: a program with
//! threads of different priorities connects its node in the thread with the highest one. The background thread ends
//! with the last handle of the node. If the program's `tracing` subscriber panics on the thread, the thread
//! continues. A child that was made by `fork(2)` does not have the thread: it must not use the node, but it may drop
//! its copies of all handles. The node belongs to the process that connected it: when this process ends, the Manager
//! ends the session and its links, also if a child still has the descriptors.
//!
//! [`NodeBuilder::background`] turns the thread off. Then every call *drives* the whole node, and calls that wait keep
//! driving it meanwhile. [`Node::spin`] is for programs that have nothing else to call.
//!
//! # Waiting for several things
//!
//! | to wait for | use |
//! | --- | --- |
//! | one subscriber, server or call | its own methods |
//! | several of them, timers and descriptors | a [`WaitSet`]; the program handles the source that is ready |
//! | the same, with a closure for each | an [`Executor`], in one thread or several |
//! | messages of several topics that belong together | a [`Synchronizer`], alone or in one of the two |
//! | peers that join or leave, and losses | [`Events`], alone or in one of the two |
//! | the next tick | a [`Rate`] |
//!
//! A [`Shutdown`] ends all these waits. The example `robot` is a complete program.
//!
//! # Parameters
//!
//! A node can have [parameters](params): typed values with defaults, ranges and descriptions, which come from files and
//! the environment, and which `sm2 param` reads, watches and sets while the program runs.
//!
//! # In your own event loop
//!
//! A node fits into every loop that can wait until a descriptor is readable. Each of these types implements
//! `AsFd`. Without a background thread, the descriptor of an interface also becomes readable when its node has
//! something to do:
//!
//! | for a | watch | when readable, call |
//! | --- | --- | --- |
//! | [`Subscriber`] | it | [`Subscriber::try_recv`] |
//! | [`Server`] | it | [`Server::try_recv`] |
//! | [`Client`] | it, while calls are pending | [`Call::try_wait`] of all pending calls |
//! | program that watches the domain, or has none of these | the [`Node`] | [`Node::spin_some`] |
//!
//! - No further call is needed: a background thread does the rest, or else each of these calls drives the whole node.
//! - A descriptor stays readable until its call has returned that there is nothing more. That holds even if
//!   another call, such as a publication, has read the message from its socket. An iteration may therefore
//!   take one message or all.
//! - Watch the descriptors level-triggered. If a loop reports only changes (mio, multishot requests of
//!   io_uring), register the descriptor again after each iteration.
//! - No timer is needed: the node's own timers make the same descriptors readable. The only exception is the
//!   deadline of a call without a reply, which [`Call::try_wait`] reports.
//! - [`Publisher::publish`] waits for reliable subscribers, for at most the
//!   [`PublisherBuilder::publish_timeout`] and within the [`PublisherBuilder::wait_share_percent`]. A loop
//!   that must not wait sets `Duration::ZERO`.
//! - [`Client::send`] waits while the link to the first server is being opened, and `declare` waits for the
//!   Manager. A loop calls both at its start.
//!
//! The examples `loop_epoll`, `loop_mio` and `loop_io_uring` are complete programs.
//!
//! # When the Manager ends
//!
//! Links stay open, and messages continue to flow. The node connects to another Manager by itself and tells
//! it about its interfaces and links: see [`Node`]. In a domain without a daemon, the nodes bring a Manager
//! along (`NodeBuilder::embed_manager`, feature `embedded-manager`).
//!
//! # Inspecting the domain
//!
//! [`Node::snapshot`] returns the whole domain and [`Node::watch`] its changes. [`Publisher::why`], like the
//! same method of the other interfaces, explains missing links. [`Node::inspect`] reads the counters of
//! another node.
//!
//! # Conventions
//!
//! *Waiting.* Each operation that waits exists in up to three forms, named as in the standard
//! library and in crossbeam:
//!
//! | form | waits at most |
//! | --- | --- |
//! | `recv()`, `wait_for_subscribers(n)`, `call(..)`, `spin_once()` | without limit |
//! | `recv_timeout(d)`, `wait_for_subscribers_timeout(n, d)`, `call_timeout(.., d)`, `spin_once_timeout(d)` | `d` |
//! | `try_recv()`, `try_wait()`, and [`Node::spin_some`] | not at all |
//!
//! A time limit is never an `Option`. After its time limit, a call without a result returns `None`, an empty
//! collection, 0 or `false`. It returns an error if a condition that the program asked for (enough links, a
//! reply, a Manager) was not met. [`Publisher::publish`] has one form, because only reliable subscribers can
//! make it wait: its time limit is a property of the publisher.
//!
//! *Builders.* `node.publisher("topic")` declares with the defaults. `node.publisher_builder("topic")`
//! returns a builder, which [`declare`](PublisherBuilder::declare) consumes. An option has the same name and
//! type in every builder. Its setter takes one value, also if it is a boolean (`reliable(true)`), so that a
//! value from a configuration can be passed on; setters of types take as many as there are types. The
//! setter of a time limit takes a `Duration`, and its name ends in `_timeout`. Counts are counts of messages,
//! lengths are in bytes.
//!
//! *Names.* Publishers and subscribers belong to a topic, servers and clients to a service. Methods that do
//! the same have the same name: `links`, `matched`, `is_registered`, `why`, `wait_for_…`.
//!
//! *Errors.* Each operation has its own error enumeration, such as [`PublishError`]. The `Io` variant carries
//! an error of the operating system. No input from another process causes a panic.
//!
//! # How a message travels
//!
//! | form | which messages | cost |
//! | --- | --- | --- |
//! | inline | up to `inline_max` bytes, on the socket lane | a copy for each receiver |
//! | in a cell | up to 104 bytes, by a ring | a copy into the ring of each receiver, and one out of it |
//! | pooled | longer ones, all others by a ring | one copy into a slot that all receivers read; none for a [`Loan`] |
//! | sealed | longer ones, on sealed links | new, immutable memory for each message |
//!
//! A received message in a cell (SM2-RNG-013) is a copy: it holds nothing of its sender, and does not count for
//! `max_borrowed`. A publisher uses slots instead for a [`Loan`], if it is [latched](PublisherBuilder::latched) or has
//! a [lifespan](PublisherBuilder::lifespan), and while one of its links takes no message.
//!
//! A link is sealed if either side or the Manager (`--seal-all`) requires it, or if its two nodes belong to
//! different users.
//!
//! | lane | which links | cost |
//! | --- | --- | --- |
//! | ring | unsealed links between two nodes that both [offer](NodeBuilder::ring_lane) it | two atomic words |
//! | socket | all others | a system call on each side |
//!
//! On the ring lane, a message needs no system call while both sides are awake ([`Wait`]). A thread that finds
//! its messages in rings reads its sockets only every 100 µs.
//!
//! # Further reading
//!
//! [`Node`], [`Publisher`], [`Subscriber`], [`Server`], [`Client`] and their builders; [`mod@domain`] and
//! [`diagnostics`] for tools; the examples; `SPEC.md` for the protocol. Names such as `SM2-QOS-002` refer to
//! its clauses.
#![deny(unsafe_code)]
#![deny(clippy::disallowed_types)]

// For the derive macros, whose output refers to `::sm2_node`.
extern crate self as sm2_node;

#[cfg(feature = "tokio")]
pub mod asynchronous;
mod buffer;
mod builder;
mod client;
pub mod clock;
pub mod diagnostics;
pub mod domain;
mod driver;
pub mod encoding;
mod error;
mod event;
mod events;
pub mod executor;
pub mod explain;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
mod handle;
mod link_room;
mod loan;
pub mod lockstep;
mod message;
mod node;
mod outgoing;
pub mod params;
mod payload;
mod plain;
mod pool;
#[allow(
    unsafe_code,
    reason = "the only constructor of a slice over pooled memory"
)]
mod pooled;
mod published;
mod publisher;
mod quota;
mod rate;
mod sample;
pub mod schema;
mod server;
mod shutdown;
mod spare;
mod subscriber;
pub mod synchronizer;
#[cfg(feature = "embedded-manager")]
pub mod testing;
mod timer;
mod wait;
pub mod wait_set;

pub use builder::{MAX_MAPPED_BYTES, NodeBuilder};
pub use client::{Call, Client, ClientBuilder, Reply};
pub use error::{
    CallError, ConnectError, DeclareError, PublishError, RecvError, ReplyError, StoreError,
    WaitError,
};
pub use event::Event;
pub use events::Events;
pub use executor::Executor;
pub use loan::Loan;
pub use message::{EncodeError, Message, PayloadError};
pub use node::Node;
pub use params::{Parameter, Parameters, ParametersBuilder};
pub use payload::{Payload, SharedBytes};
pub use plain::{InPlace, Plain};
pub use pool::{POOL_LIMIT_BYTES, POOL_LIMIT_MESSAGES};
pub use published::Published;
pub use publisher::{Publisher, PublisherBuilder};
pub use rate::Rate;
pub use sample::Sample;
pub use schema::Schema;
pub use server::{Request, Server, ServerBuilder};
pub use shutdown::Shutdown;
pub use sm2_io::clock::now;
pub use sm2_node_derive::{Message, Schema};
pub use sm2_proto::{Instant, Name, NameError, TypeId};
pub use subscriber::{Subscriber, SubscriberBuilder};
pub use synchronizer::Synchronizer;
pub use timer::{MissedTicks, Tick, Timer};
pub use wait::Wait;
pub use wait_set::WaitSet;
pub use {serde, zerocopy};
