//! Subscribers.

use std::ffi::{c_char, c_int};
use std::mem::MaybeUninit;

use sm2_node::SubscriberBuilder;

use crate::arguments::{FOREVER, In, Out, Text, duration, given, store_descriptor, vacant};
use crate::node::Node;
use crate::qos::SubscriberOptions;
use crate::report::{SubscriberCounters, why};
use crate::sample::Sample;
use crate::status::{Failure, Status, guard, guard_drop};
use crate::types::{Declared, Type, not_declared};

/// Receives the messages of a topic: see `sm2_subscriber_new()`.
#[derive(Debug)]
pub struct Subscriber(pub(crate) sm2_node::Subscriber<[u8]>);

/// Declares a subscriber. `type` is NULL for raw bytes (or for the option `any_type`), and `options` for the defaults.
///
/// Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
/// `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_new(
    node: Option<&Node>,
    topic: *const c_char,
    r#type: *const Type,
    options: *const SubscriberOptions,
    subscriber: Option<&mut MaybeUninit<Option<Box<Subscriber>>>>,
) -> Status {
    guard(|| {
        let subscriber = vacant(subscriber, "subscriber")?;
        let node = &given(node, "node")?.0;
        let topic = Text(topic);
        let options = In(options).read_or(SubscriberOptions::defaults)?;
        let mut builder: SubscriberBuilder<[u8]> =
            node.subscriber_builder(topic.required("topic")?);
        if let Some(declared) = Declared::read(r#type)? {
            declared.register(node)?;
            builder = builder.type_id(declared.id);
        }
        let declared = options.apply(builder).declare();
        let declared = declared.map_err(|error| not_declared(node, error))?;
        *subscriber = Some(Box::new(Subscriber(declared)));
        Ok(())
    })
}

/// Frees a subscriber, which is withdrawn; NULL is ignored. Samples that were taken before stay valid.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_free(subscriber: Option<Box<Subscriber>>) {
    guard_drop(subscriber);
}

/// Takes the next message. Waits for it for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
/// `SM2_FOREVER`. The message is read where the publisher wrote it: see `sm2_sample_data()`.
///
/// `*sample` is NULL, or a sample of an earlier call. In the second case its message is released first, and the handle
/// is used again, so that a loop does not allocate. Without a message it stays released.
///
/// Errors: `SM2_TIMED_OUT`, `SM2_BORROW_LIMIT` if the program holds `max_borrowed` samples, `SM2_UNREADABLE`,
/// `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time with other samples; each message is taken once.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_recv(
    subscriber: Option<&Subscriber>,
    timeout_ns: u64,
    sample: Option<&mut Option<Box<Sample>>>,
) -> Status {
    guard(|| {
        let place = given(sample, "sample")?;
        let subscriber = &given(subscriber, "subscriber")?.0;
        if let Some(earlier) = place {
            earlier.release();
        }
        let received = match timeout_ns {
            0 => subscriber.try_recv()?,
            FOREVER => Some(subscriber.recv()?),
            ns => subscriber.recv_timeout(duration(ns))?,
        };
        let received = received.ok_or(Failure::TIMED_OUT)?;
        place.get_or_insert_default().fill(received);
        Ok(())
    })
}

/// Waits until at least `count` publishers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_wait_for_publishers(
    subscriber: Option<&Subscriber>,
    count: usize,
    timeout_ns: u64,
) -> Status {
    guard(|| {
        let subscriber = &given(subscriber, "subscriber")?.0;
        match timeout_ns {
            FOREVER => subscriber.wait_for_publishers(count)?,
            ns => subscriber.wait_for_publishers_timeout(count, duration(ns))?,
        }
        Ok(())
    })
}

/// Stores a descriptor in `fd` that is readable when `sm2_subscriber_recv()` with the limit 0 may have a message. Take
/// messages until there is none, then poll again, level-triggered. The subscriber keeps the descriptor; do not close
/// it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_descriptor(
    subscriber: Option<&Subscriber>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(subscriber, "subscriber")?.0, fd))
}

/// Fills `counters`.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_counters(
    subscriber: Option<&Subscriber>,
    counters: *mut SubscriberCounters,
) -> Status {
    guard(|| {
        let counters = Out(counters).required("counters")?;
        let subscriber = &given(subscriber, "subscriber")?.0;
        counters.write(&SubscriberCounters::of(subscriber));
        Ok(())
    })
}

/// Explains why the subscriber has no links: stores a text in `text`, with a line for each publisher that comes close.
/// The text is empty if there is none. Free it with `sm2_text_free()`.
///
/// Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_subscriber_why(
    subscriber: Option<&Subscriber>,
    text: Option<&mut MaybeUninit<*mut c_char>>,
) -> Status {
    guard(|| why(text, || Ok(given(subscriber, "subscriber")?.0.why()?)))
}
