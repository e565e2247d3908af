//! The driver of a node: its sockets, the machines behind the sockets, and the threads that wait.
//!
//! | file or folder | content |
//! | --- | --- |
//! | `shared_node` | [`SharedNode`]: the state that all handles of a node share, and its lock |
//! | `inner` | [`Inner`]: the state under the lock |
//! | `context` | the parts of `Inner` that a call lends to an interface and its links |
//! | `drive` | [`Inner::drive`] reads and writes the sockets that are ready: most calls begin with it |
//! | `background` | the thread that drives the control side |
//! | `event_sets` | which descriptors wake calls, and which wake the background thread |
//! | `session` | the connection with the Manager, requests of handles, and the way back to a Manager |
//! | `questions` | queries of the program to the Manager, and the answers |
//! | `interface` | one publisher, subscriber, server or client: its links, and the work with its messages |
//! | `link` | one end of one link: its socket and machine, sending, taking, mapped memory |
//! | `outbox` | the messages of an interface that are not settled, and the memory that they are in |
//! | `counters`, `status` | what tools and programs can read about interfaces and links |
//! | `wait`, `sleepers`, `bell` | threads that wait without the lock, and descriptors to poll |
//! | `limits`, `limited_warning` | how much work one call does, how much is kept and logged |
//!
//! Dependencies point one way: `shared_node`, then `inner` and the files that extend it (`drive`,
//! `session`, `questions`), then `interface`, `link`, `outbox`. Only `session/outputs.rs` and
//! `link/outputs.rs` match the outputs of the machines of `sm2-proto`.

mod background;
mod bell;
mod context;
mod counters;
mod datagram;
mod drive;
mod event_sets;
mod inner;
mod interface;
mod limited_warning;
mod limits;
mod link;
mod outbox;
mod questions;
mod session;
mod shared_node;
mod sleepers;
mod status;
mod token;
mod wait;

pub(crate) use self::bell::Bell;
pub(crate) use self::context::Context;
pub(crate) use self::event_sets::EventSets;
pub(crate) use self::inner::Inner;
pub(crate) use self::interface::{CallId, Choice, Full, Interface, Offered, Outcome, State, Taken};
pub(crate) use self::outbox::{Forms, Needs, NoSlot, PoolLimit, Reservation, Reserved};
pub(crate) use self::questions::{Answer, Followed, Lost, Question, Ticket};
pub(crate) use self::session::may_return;
pub(crate) use self::shared_node::{Settings, SharedNode};
pub(crate) use self::sleepers::EventSource;
pub use self::status::{LinkStatus, Received};
pub(crate) use self::token::LinkToken;
pub(crate) use self::wait::Until;
