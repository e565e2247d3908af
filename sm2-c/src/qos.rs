//! The quality of service of each kind of interface.

use sm2_node::{ClientBuilder, PublisherBuilder, ServerBuilder, SubscriberBuilder, Wait};

use crate::arguments::{FOREVER, duration, period, set_defaults, sized};
use crate::status::{Failure, Status, guard};

/// A size that the library chooses: `UINT64_MAX`.
pub const AUTOMATIC: u64 = u64::MAX;

/// The quality of service of a publisher, and its memory. `sm2_publisher_options_init()` sets the defaults. Fields that
/// are true or false have the values 1 and 0.
#[repr(C)]
#[derive(Debug)]
pub struct PublisherOptions {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// How long a publication waits for reliable subscribers without room, in nanoseconds; 100 ms by default. With 0 it
    /// never waits.
    pub publish_timeout_ns: u64,
    /// Promises a message at least once in each such period, in nanoseconds; 0, no promise, by default.
    pub deadline_ns: u64,
    /// Promises a sign of life within each such lease, in nanoseconds; 0, no promise, by default.
    pub liveliness_ns: u64,
    /// The age that ends the delivery of messages, in nanoseconds; 0, none, by default.
    pub lifespan_ns: u64,
    /// How long unused memory is kept, in nanoseconds; 5 s by default.
    pub keep_idle_ns: u64,
    /// The most memory for messages, in bytes, besides reserved memory; `SM2_AUTOMATIC` by default.
    pub pool_limit_bytes: u64,
    /// Reserves memory for messages of up to this length, in bytes; 0, no reservation, by default.
    pub max_len: u64,
    /// For how many messages `max_len` reserves memory; 0, by default, for `depth + latched + 4`.
    pub slots: u32,
    /// Messages of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
    pub inline_max: u32,
    /// How many messages wait for each subscriber: 1 to 1,024; 8 by default.
    pub depth: u16,
    /// How many messages new subscribers get first: 0 to 1,024; 0 by default.
    pub latched: u16,
    /// Whether reliable delivery is offered; 0 by default.
    pub reliable: u8,
    /// Whether every message is sealed, so that no process can change it; 0 by default.
    pub sealed: u8,
    /// Whether reserved memory is made present at once; 0 by default.
    pub prefault: u8,
    /// Whether reserved memory is locked; 0 by default.
    pub mlock: u8,
    /// The share of the time that publications may wait for reliable subscribers, in per cent; 1 by default.
    pub wait_share_percent: u8,
    /// Reserved: 0.
    pub reserved: [u8; 7],
}

/// The quality of service of a subscriber. `sm2_subscriber_options_init()` sets the defaults.
#[repr(C)]
#[derive(Debug)]
pub struct SubscriberOptions {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// Demands a message of each publisher at least once in each such period, in nanoseconds; 0, no demand, by default.
    pub deadline_ns: u64,
    /// Demands a sign of life of each publisher within each such lease, in nanoseconds; 0, no demand, by default.
    pub liveliness_ns: u64,
    /// How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
    /// sleeps.
    pub spin_ns: u64,
    /// The longest message that is accepted, in bytes; 1 GiB by default.
    pub max_len: u64,
    /// How many messages of each publisher wait to be taken: 1 to 1,024; 8 by default.
    pub depth: u16,
    /// How many samples of each publisher the program may hold: 1 to 1,024; 4 by default. Samples of up to 104
    /// bytes usually are copies, which do not count.
    pub max_borrowed: u16,
    /// Whether reliable delivery is requested; 0 by default.
    pub reliable: u8,
    /// Whether only sealed messages are accepted; 0 by default.
    pub sealed: u8,
    /// Whether messages of every type are accepted: see `sm2_sample_info()`. 0 by default.
    pub any_type: u8,
    /// Reserved: 0.
    pub reserved: u8,
}

/// The options of a server. `sm2_server_options_init()` sets the defaults.
#[repr(C)]
#[derive(Debug)]
pub struct ServerOptions {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
    /// sleeps.
    pub spin_ns: u64,
    /// The longest request that is accepted, in bytes; 1 GiB by default.
    pub max_len: u64,
    /// Replies of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
    pub inline_max: u32,
    /// How many requests of each client wait: 1 to 1,024; 64 by default.
    pub depth: u16,
    /// How many requests of each client the program may hold: 1 to 1,024; 16 by default. Short ones do not count, as
    /// for samples.
    pub max_borrowed: u16,
    /// Whether every request and reply is sealed; 0 by default.
    pub sealed: u8,
    /// Reserved: 0.
    pub reserved: [u8; 7],
}

/// The options of a client. `sm2_client_options_init()` sets the defaults.
#[repr(C)]
#[derive(Debug)]
pub struct ClientOptions {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
    /// sleeps.
    pub spin_ns: u64,
    /// The longest reply that is accepted, in bytes; 1 GiB by default.
    pub max_len: u64,
    /// Requests of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
    pub inline_max: u32,
    /// How many pending calls and replies of each server the program may hold: 1 to 1,024; 64 by default. Short replies
    /// do not count, as for samples.
    pub max_borrowed: u16,
    /// Whether every request and reply is sealed; 0 by default.
    pub sealed: u8,
    /// Reserved: 0.
    pub reserved: u8,
}

sized! {
    PublisherOptions, reserved: [u8; 7] = "sm2_publisher_options_t";
    SubscriberOptions, reserved: u8 = "sm2_subscriber_options_t";
    ServerOptions, reserved: [u8; 7] = "sm2_server_options_t";
    ClientOptions, reserved: u8 = "sm2_client_options_t";
}

/// The longest message that an interface accepts by default, in bytes.
const MAX_LEN: u64 = 1 << 30;
/// The longest message that is copied into a datagram by default, in bytes.
const INLINE_MAX: u32 = 4_096;

impl PublisherOptions {
    pub(crate) fn defaults() -> Self {
        Self {
            size: size_of::<Self>(),
            publish_timeout_ns: 100_000_000,
            deadline_ns: 0,
            liveliness_ns: 0,
            lifespan_ns: 0,
            keep_idle_ns: 5_000_000_000,
            pool_limit_bytes: AUTOMATIC,
            max_len: 0,
            slots: 0,
            inline_max: INLINE_MAX,
            depth: 8,
            latched: 0,
            reliable: 0,
            sealed: 0,
            prefault: 0,
            mlock: 0,
            wait_share_percent: 1,
            reserved: [0; 7],
        }
    }

    pub(crate) fn apply(
        &self,
        mut builder: PublisherBuilder<[u8]>,
    ) -> Result<PublisherBuilder<[u8]>, Failure> {
        if let Some(deadline) = period(self.deadline_ns) {
            builder = builder.deadline(deadline);
        }
        if let Some(lease) = period(self.liveliness_ns) {
            builder = builder.liveliness(lease);
        }
        if let Some(age) = period(self.lifespan_ns) {
            builder = builder.lifespan(age);
        }
        if self.pool_limit_bytes != AUTOMATIC {
            builder = builder.pool_limit(self.pool_limit_bytes);
        }
        if self.max_len != 0 {
            builder = builder.max_len(length(self.max_len, "max_len")?);
        }
        if self.slots != 0 {
            builder = builder.slots(self.slots);
        }
        Ok(builder
            .publish_timeout(duration(self.publish_timeout_ns))
            .keep_idle(duration(self.keep_idle_ns))
            .inline_max(length(self.inline_max.into(), "inline_max")?)
            .depth(self.depth)
            .latched(self.latched)
            .reliable(self.reliable != 0)
            .sealed(self.sealed != 0)
            .prefault(self.prefault != 0)
            .mlock(self.mlock != 0)
            .wait_share_percent(self.wait_share_percent))
    }
}

impl SubscriberOptions {
    pub(crate) const fn defaults() -> Self {
        Self {
            size: size_of::<Self>(),
            deadline_ns: 0,
            liveliness_ns: 0,
            spin_ns: 0,
            max_len: MAX_LEN,
            depth: 8,
            max_borrowed: 4,
            reliable: 0,
            sealed: 0,
            any_type: 0,
            reserved: 0,
        }
    }

    pub(crate) fn apply(&self, mut builder: SubscriberBuilder<[u8]>) -> SubscriberBuilder<[u8]> {
        if let Some(deadline) = period(self.deadline_ns) {
            builder = builder.deadline(deadline);
        }
        if let Some(lease) = period(self.liveliness_ns) {
            builder = builder.liveliness(lease);
        }
        if self.any_type != 0 {
            builder = builder.any_type();
        }
        builder
            .wait(wait(self.spin_ns))
            .max_len(self.max_len)
            .depth(self.depth)
            .max_borrowed(self.max_borrowed)
            .reliable(self.reliable != 0)
            .sealed(self.sealed != 0)
    }
}

impl ServerOptions {
    pub(crate) const fn defaults() -> Self {
        Self {
            size: size_of::<Self>(),
            spin_ns: 0,
            max_len: MAX_LEN,
            inline_max: INLINE_MAX,
            depth: 64,
            max_borrowed: 16,
            sealed: 0,
            reserved: [0; 7],
        }
    }

    pub(crate) fn apply(
        &self,
        builder: ServerBuilder<[u8], [u8]>,
    ) -> Result<ServerBuilder<[u8], [u8]>, Failure> {
        Ok(builder
            .wait(wait(self.spin_ns))
            .max_len(self.max_len)
            .inline_max(length(self.inline_max.into(), "inline_max")?)
            .depth(self.depth)
            .max_borrowed(self.max_borrowed)
            .sealed(self.sealed != 0))
    }
}

impl ClientOptions {
    pub(crate) const fn defaults() -> Self {
        Self {
            size: size_of::<Self>(),
            spin_ns: 0,
            max_len: MAX_LEN,
            inline_max: INLINE_MAX,
            max_borrowed: 64,
            sealed: 0,
            reserved: 0,
        }
    }

    pub(crate) fn apply(
        &self,
        builder: ClientBuilder<[u8], [u8]>,
    ) -> Result<ClientBuilder<[u8], [u8]>, Failure> {
        Ok(builder
            .wait(wait(self.spin_ns))
            .max_len(self.max_len)
            .inline_max(length(self.inline_max.into(), "inline_max")?)
            .max_borrowed(self.max_borrowed)
            .sealed(self.sealed != 0))
    }
}

/// How a thread waits that polls for `spin_ns` nanoseconds first.
fn wait(spin_ns: u64) -> Wait {
    match spin_ns {
        0 => Wait::Park,
        FOREVER => Wait::Spin,
        ns => Wait::SpinThenPark(duration(ns)),
    }
}

/// A length of this machine.
fn length(bytes: u64, name: &str) -> Result<usize, Failure> {
    usize::try_from(bytes).map_err(|_| {
        Failure::misuse(format!(
            "the option '{name}' is {bytes} bytes: no object is that long"
        ))
    })
}

/// Sets the default options. `options->size` must be set before, as for every struct.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_options_init(options: *mut PublisherOptions) -> Status {
    guard(|| set_defaults(options, &PublisherOptions::defaults()))
}

/// Sets the default options. `options->size` must be set before, as for every struct.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_options_init(options: *mut SubscriberOptions) -> Status {
    guard(|| set_defaults(options, &SubscriberOptions::defaults()))
}

/// Sets the default options. `options->size` must be set before, as for every struct.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_options_init(options: *mut ServerOptions) -> Status {
    guard(|| set_defaults(options, &ServerOptions::defaults()))
}

/// Sets the default options. `options->size` must be set before, as for every struct.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_options_init(options: *mut ClientOptions) -> Status {
    guard(|| set_defaults(options, &ClientOptions::defaults()))
}
