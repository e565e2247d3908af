//! Publishers.

use std::ffi::{c_char, c_int, c_void};
use std::mem::MaybeUninit;
use std::sync::Arc;

use sm2_node::PublisherBuilder;

use crate::arguments::{Bytes, FOREVER, In, Out, Text, duration, given, store_descriptor, vacant};
use crate::node::Node;
use crate::qos::PublisherOptions;
use crate::report::{PublishResult, PublisherCounters, why};
use crate::status::{Failure, Status, guard, guard_drop};
use crate::types::{Declared, Type, not_declared};

/// Sends the messages of a topic: see `sm2_publisher_new()`.
#[derive(Debug)]
pub struct Publisher(pub(crate) Arc<sm2_node::Publisher<[u8]>>);

/// Declares a publisher. `type` is NULL for raw bytes, and `options` for the defaults.
///
/// Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
/// `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_new(
    node: Option<&Node>,
    topic: *const c_char,
    r#type: *const Type,
    options: *const PublisherOptions,
    publisher: Option<&mut MaybeUninit<Option<Box<Publisher>>>>,
) -> Status {
    guard(|| {
        let publisher = vacant(publisher, "publisher")?;
        let node = &given(node, "node")?.0;
        let topic = Text(topic);
        let options = In(options).read_or(PublisherOptions::defaults)?;
        let mut builder: PublisherBuilder<[u8]> = node.publisher_builder(topic.required("topic")?);
        if let Some(declared) = Declared::read(r#type)? {
            declared.register(node)?;
            builder = builder.type_id(declared.id);
        }
        let declared = options.apply(builder)?.declare();
        let declared = declared.map_err(|error| not_declared(node, error))?;
        *publisher = Some(Box::new(Publisher(Arc::new(declared))));
        Ok(())
    })
}

/// Frees a publisher; NULL is ignored. The publisher is withdrawn when its last loan is freed as well.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_free(publisher: Option<Box<Publisher>>) {
    guard_drop(publisher);
}

/// Sends the `len` bytes at `data` to all subscribers: one copy into shared memory. `result` may be NULL. A reliable
/// subscriber that misses the message is not an error, because all others have it: see `sm2_publish_result_t`.
///
/// Waits only for reliable subscribers without room, for at most the option `publish_timeout_ns`.
///
/// Errors: `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time; each subscriber gets the messages of one thread in order.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_publish(
    publisher: Option<&Publisher>,
    data: *const c_void,
    len: usize,
    result: *mut PublishResult,
) -> Status {
    guard(|| {
        let publisher = &given(publisher, "publisher")?.0;
        let bytes = Bytes(data);
        PublishResult::of(result, || Ok(publisher.publish(bytes.slice(len, "data")?)?))
    })
}

/// Sends the `len` bytes at `data` to all subscribers, or to none: `SM2_TIMED_OUT` if `sm2_publisher_publish()` would
/// wait for a reliable subscriber. `result` may be NULL.
///
/// Errors: as `sm2_publisher_publish()`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_try_publish(
    publisher: Option<&Publisher>,
    data: *const c_void,
    len: usize,
    result: *mut PublishResult,
) -> Status {
    guard(|| {
        let publisher = &given(publisher, "publisher")?.0;
        let bytes = Bytes(data);
        PublishResult::of(result, || {
            let published = publisher.try_publish(bytes.slice(len, "data")?)?;
            published.ok_or(Failure::TIMED_OUT)
        })
    })
}

/// Waits until no message waits in the publisher: reliable subscribers have released all messages, and all others were
/// sent theirs. For at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_TIMED_OUT`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_flush(publisher: Option<&Publisher>, timeout_ns: u64) -> Status {
    guard(|| {
        let publisher = &given(publisher, "publisher")?.0;
        let flushed = match timeout_ns {
            FOREVER => publisher.flush().map(|()| true)?,
            timeout_ns => publisher.flush_timeout(duration(timeout_ns))?,
        };
        flushed.then_some(()).ok_or(Failure::TIMED_OUT)
    })
}

/// Waits until at least `count` subscribers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_wait_for_subscribers(
    publisher: Option<&Publisher>,
    count: usize,
    timeout_ns: u64,
) -> Status {
    guard(|| {
        let publisher = &given(publisher, "publisher")?.0;
        match timeout_ns {
            FOREVER => publisher.wait_for_subscribers(count)?,
            ns => publisher.wait_for_subscribers_timeout(count, duration(ns))?,
        }
        Ok(())
    })
}

/// Asserts that the program is alive, as each publication does: for a publisher with the option `liveliness_ns` that
/// has nothing to publish.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_assert_liveliness(publisher: Option<&Publisher>) -> Status {
    guard(|| {
        given(publisher, "publisher")?.0.assert_liveliness();
        Ok(())
    })
}

/// Fills `counters`: the fates of all messages.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_counters(
    publisher: Option<&Publisher>,
    counters: *mut PublisherCounters,
) -> Status {
    guard(|| {
        let counters = Out(counters).required("counters")?;
        let publisher = &given(publisher, "publisher")?.0;
        counters.write(&PublisherCounters::of(publisher));
        Ok(())
    })
}

/// Explains why the publisher has no links: stores a text in `text`, with a line for each subscriber that comes close.
/// The text is empty if there is none. Free it with `sm2_text_free()`.
///
/// Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_why(
    publisher: Option<&Publisher>,
    text: Option<&mut MaybeUninit<*mut c_char>>,
) -> Status {
    guard(|| {
        why(text, || {
            given(publisher, "publisher")?.0.why().map_err(Into::into)
        })
    })
}

/// Stores a descriptor in `fd` that is readable when a reliable subscriber may have room again, or a link has changed.
/// The publisher keeps the descriptor; do not close it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_descriptor(
    publisher: Option<&Publisher>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(publisher, "publisher")?.0, fd))
}
