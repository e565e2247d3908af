//! The driver of a node: its sockets, the machines behind the sockets, and the threads that wait.
//!
//! A node has two sides. The *control side* has the session with the Manager and looks after links that open or end; a
//! background thread drives it. The *data side* has the interfaces, each with its own lock; the calls of the program
//! drive them.
//!
//! | file or folder | content |
//! | --- | --- |
//! | `shared_node` | [`SharedNode`]: the node as its handles share it, and the lock of the control side |
//! | `background` | the thread that drives the control side |
//! | `control`, `drive` | [`Control`]: the state under that lock, and the work of its pending events |
//! | `session` | the connection with the Manager, requests of handles, and the way back to a Manager |
//! | `qos_timer` | the timer of deadlines and leases, and the interfaces that it ticks |
//! | `questions` | queries of the program to the Manager, and the answers |
//! | `shared_interface` | [`SharedInterface`]: an interface as its handles and samples share it, and its lock |
//! | `context` | the parts of an interface's driver that a call lends to the interface and its links |
//! | `interface` | one publisher, subscriber, server or client: its links, and the work with its messages |
//! | `link` | one end of one link: its socket and machine, sending, taking, mapped memory |
//! | `origin` | the link that messages came from, which all its samples share |
//! | `outbox` | the messages of an interface that are not settled, and the memory that they are in |
//! | `leftovers` | memory of messages that goes back to the system in parts |
//! | `counters`, `status` | what tools and programs can read about interfaces and links |
//! | `event_sets` | which descriptors wake calls, and which wake the background thread |
//! | `wait`, `paced_wait`, `pace`, `sleep`, `sleepers`, `next_words` | threads that wait without a lock |
//! | `bell`, `control_bell`, `watch`, `undriven_control` | waiting in the loop of a program, and in a wait set |
//! | `limits`, `limited_warning` | how much work one call does, how much is kept and logged |
//!
//! The order of locks: a thread that holds the lock of the control side may take that of an interface. A thread that
//! holds the lock of an interface takes no other lock of the node, and none is held while a thread sleeps. A call of an
//! interface leaves results for the control side (`interface::ForControl`), which are handled after the interface is
//! unlocked.
//!
//! Dependencies point one way: `shared_node`, then `control` and the files that extend it (`drive`, `session`,
//! `questions`), then `shared_interface`, `interface`, `link`, `outbox`. Only `session/outputs.rs` and
//! `link/socket.rs` match the outputs of the machines of `sm2-proto`.

mod background;
mod bell;
mod context;
mod control;
mod control_bell;
mod counters;
mod datagram;
mod drive;
mod event_sets;
mod interface;
mod leftovers;
mod limited_warning;
mod limits;
mod link;
mod next_words;
mod origin;
mod outbox;
mod pace;
mod paced_wait;
mod qos_timer;
mod questions;
mod session;
mod shared_interface;
mod shared_node;
mod sleep;
mod sleepers;
#[cfg(test)]
mod sleepers_tests;
mod status;
mod token;
mod undriven_control;
mod wait;
mod watch;

pub(crate) use self::bell::Bell;
pub(crate) use self::context::Context;
pub(crate) use self::control::Control;
pub(crate) use self::control_bell::ControlBell;
pub(crate) use self::event_sets::NodeSets;
pub(crate) use self::interface::{
    CallBody, CallId, Choice, Condition, DeclaredInterface, Full, Header, Offered, Outcome, State,
    Taken,
};
pub(crate) use self::limits::SHORTAGE_PAUSE;
pub(crate) use self::origin::{CellCopy, Held, Origin};
pub(crate) use self::outbox::{Forms, Needs, NoSlot, PoolLimit, Reservation, Reserved};
pub(crate) use self::questions::{Answer, Followed, Lost, Question, Ticket};
pub(crate) use self::session::{NotDeclared, may_return};
pub(crate) use self::shared_interface::{
    Drive, InterfaceDriver, LinkEnds, LockedInterface, SharedInterface,
};
pub(crate) use self::shared_node::{Settings, SharedNode};
pub use self::status::{LinkStatus, Received};
pub(crate) use self::token::LinkToken;
pub(crate) use self::undriven_control::UndrivenControl;
pub(crate) use self::wait::{Until, WaitFailure};
pub(crate) use self::watch::Watch;
