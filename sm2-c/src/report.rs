//! Results of calls: the result of a publication, counters, and why there are no links.

use std::ffi::{CString, c_char};
use std::mem::MaybeUninit;

use sm2_node::Published;
use sm2_node::domain::Near;

use crate::arguments::{Out, given, nanoseconds, sized};
use crate::status::{Failure, guard};

/// The result of one publication.
#[repr(C)]
#[derive(Debug)]
pub struct PublishResult {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// How many subscribers accepted the message.
    pub links: u64,
    /// How many reliable subscribers miss this message, because they had no room in time or do not accept its length.
    pub missed: u64,
    /// How many subscribers miss this message because it is longer than their `max_len`.
    pub too_long: u64,
}

/// The fates of the messages of a publisher, summed over all current and past links: `offered = delivered + overwritten
/// + discarded + no_room + closed + pool_limit + too_long + expired + in_flight`.
#[repr(C)]
#[derive(Debug)]
pub struct PublisherCounters {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// Messages that were published while no subscriber was linked.
    pub unheard: u64,
    /// Messages offered to a link.
    pub offered: u64,
    /// Messages that the subscriber took and released.
    pub delivered: u64,
    /// Messages that wait or are not released yet.
    pub in_flight: u64,
    /// Messages that a newer one displaced before they were sent.
    pub overwritten: u64,
    /// Messages that a newer one displaced at the subscriber, or that it dropped.
    pub discarded: u64,
    /// Messages that a reliable subscriber had no room for in time.
    pub no_room: u64,
    /// Messages that were lost with their link.
    pub closed: u64,
    /// Messages that were not sent because the subscriber holds too much memory.
    pub pool_limit: u64,
    /// Messages longer than the subscriber accepts.
    pub too_long: u64,
    /// Messages older than their lifespan.
    pub expired: u64,
    /// Periods of the deadline that passed without a message.
    pub missed_deadlines: u64,
    /// How often the publisher stopped being alive.
    pub lost_liveliness: u64,
    /// How long publications waited for reliable subscribers, in nanoseconds.
    pub waited_ns: u64,
    /// The shared memory of the messages, in bytes.
    pub pool_bytes: u64,
    /// The open links.
    pub links: u64,
}

/// The counters of a subscriber, summed over all publishers.
#[repr(C)]
#[derive(Debug)]
pub struct SubscriberCounters {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// Messages that were lost. A loss counts once the next message of its publisher is taken.
    pub lost: u64,
    /// Periods of the deadline that passed without a message.
    pub missed_deadlines: u64,
    /// How often publishers stopped being alive.
    pub lost_liveliness: u64,
    /// The open links.
    pub links: u64,
}

sized! {
    PublishResult, too_long: u64 = "sm2_publish_result_t";
    PublisherCounters, links: u64 = "sm2_publisher_counters_t";
    SubscriberCounters, links: u64 = "sm2_subscriber_counters_t";
}

impl PublishResult {
    /// Publishes, and writes the result to `place` unless that is NULL.
    pub(crate) fn of(
        place: *mut Self,
        publish: impl FnOnce() -> Result<Published, Failure>,
    ) -> Result<(), Failure> {
        let place = Out(place).optional()?;
        let Published {
            links,
            missed,
            too_long,
        } = publish()?;
        if let Some(place) = place {
            place.write(&Self {
                size: size_of::<Self>(),
                links: links as u64,
                missed: missed as u64,
                too_long: too_long as u64,
            });
        }
        Ok(())
    }
}

impl PublisherCounters {
    pub(crate) fn of(publisher: &sm2_node::Publisher<[u8]>) -> Self {
        let counters = publisher.counters();
        Self {
            size: size_of::<Self>(),
            offered: counters.offered,
            delivered: counters.delivered,
            overwritten: counters.overwritten,
            discarded: counters.discarded,
            no_room: counters.no_room,
            closed: counters.closed,
            pool_limit: counters.pool_limit,
            too_long: counters.too_long,
            expired: counters.expired,
            in_flight: counters.in_flight,
            unheard: publisher.unheard(),
            missed_deadlines: publisher.missed_deadlines(),
            lost_liveliness: publisher.lost_liveliness(),
            waited_ns: nanoseconds(publisher.waited()),
            pool_bytes: publisher.pool_bytes(),
            links: publisher.links().iter().filter(|it| it.open).count() as u64,
        }
    }
}

impl SubscriberCounters {
    pub(crate) fn of(subscriber: &sm2_node::Subscriber<[u8]>) -> Self {
        Self {
            size: size_of::<Self>(),
            lost: subscriber.lost(),
            missed_deadlines: subscriber.missed_deadlines(),
            lost_liveliness: subscriber.lost_liveliness(),
            links: subscriber.links().iter().filter(|it| it.open).count() as u64,
        }
    }
}

/// Stores a text that explains missing links in `place`.
pub(crate) fn why(
    place: Option<&mut MaybeUninit<*mut c_char>>,
    ask: impl FnOnce() -> Result<Vec<Near>, Failure>,
) -> Result<(), Failure> {
    store_text(place, "text", || {
        let lines: Vec<_> = ask()?.iter().map(ToString::to_string).collect();
        // Verdicts have names and types of other nodes, which have no NUL.
        Ok(CString::new(lines.join("\n")).unwrap_or_default())
    })
}

/// Stores a text in `place`, for [`sm2_text_free`]. `name` is that of the argument. After a failure it is NULL.
pub(crate) fn store_text(
    place: Option<&mut MaybeUninit<*mut c_char>>,
    name: &str,
    make: impl FnOnce() -> Result<CString, Failure>,
) -> Result<(), Failure> {
    let place = given(place, name)?.write(std::ptr::null_mut());
    *place = make()?.into_raw();
    Ok(())
}

/// Frees a text that the library made; NULL is ignored.
///
/// Threads: any, but no other call may use this text at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_text_free(text: *mut c_char) {
    guard(|| {
        if !text.is_null() {
            // SAFETY: the header demands a text of this library, made by `CString::into_raw` like all of them, that is
            // not freed twice. The program does not change its length, because it may only read the text.
            drop(unsafe { CString::from_raw(text) });
        }
        Ok(())
    });
}
