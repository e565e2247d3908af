//! Nodes.

use std::ffi::{c_char, c_int};
use std::mem::MaybeUninit;

use sm2_node::NodeBuilder;

use crate::arguments::{
    FOREVER, In, Text, duration, given, set_defaults, sized, store_descriptor, vacant,
};
use crate::shutdown::Shutdown;
use crate::status::{Failure, Status, guard, guard_drop};

/// A node of a domain: see `sm2_node_connect()`.
#[derive(Debug)]
pub struct Node(pub(crate) sm2_node::Node);

/// How a node connects. `sm2_node_options_init()` sets the defaults.
#[repr(C)]
#[derive(Debug)]
pub struct NodeOptions {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// The domain; NULL, the default, for that of the environment (`SM2_SOCKET`, `SM2_DOMAIN`).
    pub domain: *const c_char,
    /// The path of the Manager's socket, in place of a domain; NULL by default.
    pub socket: *const c_char,
    /// A handle that ends every wait of the node; NULL by default. The node keeps what it needs of it.
    pub shutdown: *const Shutdown,
    /// How long the Manager may take for each answer, in nanoseconds; 5 s by default.
    pub manager_timeout_ns: u64,
    /// How long `sm2_node_connect()` waits for a Manager to start, in nanoseconds; 0, no waiting, by default.
    pub startup_timeout_ns: u64,
    /// How many bytes the node maps of the memory of other nodes; 1 TiB by default.
    pub max_mapped_bytes: u64,
    /// Whether a thread of the node does its control work: 1 yes, 0 no. -1, the default, for yes unless the environment
    /// has `SM2_BACKGROUND=off`. Without the thread, the program must call the node regularly.
    pub background: i8,
    /// Whether links may use rings in shared memory: 1 yes, 0 no. -1, the default, for yes unless the environment has
    /// `SM2_RING_LANE=off`.
    pub ring_lane: i8,
    /// Whether this process runs a Manager on a thread of its own if the domain has none, and otherwise stands by to
    /// take over: 1 yes, 0 no. 0 by default.
    pub embed_manager: u8,
    /// Reserved: 0.
    pub reserved: [u8; 5],
}

sized! { NodeOptions, reserved: [u8; 5] = "sm2_node_options_t"; }

impl NodeOptions {
    pub(crate) fn defaults() -> Self {
        Self {
            size: size_of::<Self>(),
            domain: std::ptr::null(),
            socket: std::ptr::null(),
            shutdown: std::ptr::null(),
            manager_timeout_ns: 5_000_000_000,
            startup_timeout_ns: 0,
            max_mapped_bytes: sm2_node::MAX_MAPPED_BYTES,
            background: -1,
            ring_lane: -1,
            embed_manager: 0,
            reserved: [0; 5],
        }
    }

    pub(crate) fn apply(&self, mut builder: NodeBuilder) -> Result<NodeBuilder, Failure> {
        if let Some(domain) = Text(self.domain).optional("domain")? {
            builder = builder.domain(domain);
        }
        if let Some(socket) = Text(self.socket).optional("socket")? {
            builder = builder.socket(socket);
        }
        // SAFETY: the header demands that this is NULL or a handle that is not freed during the call.
        if let Some(shutdown) = unsafe { self.shutdown.as_ref() } {
            builder = builder.shutdown(&shutdown.0);
        }
        if let Some(background) = choice(self.background, "background")? {
            builder = builder.background(background);
        }
        if let Some(ring_lane) = choice(self.ring_lane, "ring_lane")? {
            builder = builder.ring_lane(ring_lane);
        }
        if self.embed_manager != 0 {
            builder = builder.embed_manager(sm2_manager::Options::default());
        }
        Ok(builder
            .manager_timeout(duration(self.manager_timeout_ns))
            .startup_timeout(duration(self.startup_timeout_ns))
            .max_mapped_bytes(self.max_mapped_bytes))
    }
}

/// An option with a third value, that of the environment.
fn choice(value: i8, name: &str) -> Result<Option<bool>, Failure> {
    match value {
        -1 => Ok(None),
        0 => Ok(Some(false)),
        1 => Ok(Some(true)),
        _ => Err(Failure::misuse(format!(
            "the option '{name}' is {value}: set it to 1, 0 or -1"
        ))),
    }
}

/// Sets the default options. `options->size` must be set before, as for every struct.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_options_init(options: *mut NodeOptions) -> Status {
    guard(|| set_defaults(options, &NodeOptions::defaults()))
}

/// Connects a node to the Manager of its domain. The name must be unique in the domain. `options` may be NULL for the
/// defaults.
///
/// Messages flow on when the Manager ends; the node connects to the next one by itself. A child of `fork()` must not
/// use the node, but may free its copies of all handles.
///
/// Errors: `SM2_NO_MANAGER`, `SM2_NAME_TAKEN`, `SM2_BAD_NAME`, `SM2_REFUSED`, `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`,
/// `SM2_MISUSE`.
///
/// Threads: any. The node's background thread inherits the scheduling policy and the affinity of the calling thread.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_connect(
    name: *const c_char,
    options: *const NodeOptions,
    node: Option<&mut MaybeUninit<Option<Box<Node>>>>,
) -> Status {
    guard(|| {
        let node = vacant(node, "node")?;
        let name = Text(name);
        let options = In(options).read_or(NodeOptions::defaults)?;
        let builder = options.apply(sm2_node::Node::builder(name.required("name")?))?;
        *node = Some(Box::new(Node(builder.connect()?)));
        Ok(())
    })
}

/// Frees a handle of a node; NULL is ignored. The node ends with its last publisher, subscriber, server, client and
/// message.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_free(node: Option<Box<Node>>) {
    guard_drop(node);
}

/// Waits until the node has a session with a Manager that has answered all declarations of the node, for at most
/// `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_NO_MANAGER` after the time limit, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_wait_connected(node: Option<&Node>, timeout_ns: u64) -> Status {
    guard(|| {
        let node = &given(node, "node")?.0;
        match timeout_ns {
            FOREVER => node.wait_connected()?,
            timeout_ns => node.wait_connected_timeout(duration(timeout_ns))?,
        }
        Ok(())
    })
}

/// Drives a node without a background thread as far as possible, without waiting. Call it when the node's descriptor is
/// readable. A node with a background thread needs no such call.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_spin_some(node: Option<&Node>) -> Status {
    guard(|| Ok(given(node, "node")?.0.spin_some()?))
}

/// Stores the node's descriptor in `fd`: it is readable when a node without a background thread has work to do. The
/// node keeps the descriptor; do not close it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_node_descriptor(
    node: Option<&Node>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(node, "node")?.0, fd))
}

/// Returns the monotonic time that samples and ticks are stamped with, in nanoseconds (`CLOCK_MONOTONIC`).
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_now_ns() -> u64 {
    sm2_node::now().0
}
