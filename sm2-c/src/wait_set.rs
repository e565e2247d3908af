//! Waiting for any of many sources.

use std::collections::HashMap;
use std::ffi::c_int;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::BorrowedFd;

use sm2_node::wait_set::{Cause, Interest, Key, Ready, Waitable};
use sm2_node::{MissedTicks, Timer};

use crate::arguments::{FOREVER, Out, duration, given, sized, vacant};
use crate::client::Call;
use crate::node::Node;
use crate::publisher::Publisher;
use crate::server::Server;
use crate::shutdown::Shutdown;
use crate::status::{Failure, Status, guard, guard_drop};
use crate::subscriber::Subscriber;

/// A source of a wait set that is ready: see `sm2_wait_set_wait()`.
#[repr(C)]
#[derive(Debug)]
pub struct ReadySource {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// The tag that was added with the source.
    pub tag: u64,
    /// The number of a timer's tick, from 1; 0 for all other sources.
    pub tick: u64,
    /// The time when the tick was due, in nanoseconds of `CLOCK_MONOTONIC`.
    pub tick_due_ns: u64,
    /// How many earlier ticks were skipped.
    pub ticks_missed: u64,
    /// Whether reading a descriptor of the program does not block: 1 or 0.
    pub readable: u8,
    /// Whether writing a descriptor of the program does not block: 1 or 0.
    pub writable: u8,
    /// Reserved: 0.
    pub reserved: [u8; 6],
}

sized! { ReadySource, reserved: [u8; 6] = "sm2_ready_t"; }

/// Waits for any of many sources: see `sm2_wait_set_new()`.
#[derive(Debug)]
pub struct WaitSet {
    set: sm2_node::WaitSet<'static, u64>,
    /// The sources by tag.
    sources: HashMap<u64, Source>,
}

#[derive(Debug)]
struct Source {
    key: Key,
    /// Leaves the set when it is reported.
    is_once: bool,
}

// A program may pass a wait set to another thread, as the header says.
const _: fn() = || {
    fn can_be_sent<T: Send>() {}
    can_be_sent::<WaitSet>();
};

impl WaitSet {
    /// Adds a source whose tag no other source has.
    fn add(
        &mut self,
        tag: u64,
        is_once: bool,
        add: impl FnOnce(&mut sm2_node::WaitSet<'static, u64>) -> io::Result<Key>,
    ) -> Result<(), Failure> {
        if self.sources.contains_key(&tag) {
            return Err(Failure::misuse(format!(
                "the wait set has a source with the tag {tag}: choose another tag, or remove that source"
            )));
        }
        let key = add(&mut self.set)?;
        self.sources.insert(tag, Source { key, is_once });
        Ok(())
    }

    fn add_waitable(&mut self, source: &impl Waitable, tag: u64) -> Result<(), Failure> {
        self.add(tag, false, |set| set.add(source, tag))
    }

    /// Takes a source that leaves the set off the list.
    fn reported(&mut self, tag: u64) {
        if self.sources.get(&tag).is_some_and(|it| it.is_once) {
            self.sources.remove(&tag);
        }
    }
}

impl From<Ready<u64>> for ReadySource {
    fn from(ready: Ready<u64>) -> Self {
        let mut source = Self {
            size: size_of::<Self>(),
            tag: ready.tag,
            tick: 0,
            tick_due_ns: 0,
            ticks_missed: 0,
            readable: 0,
            writable: 0,
            reserved: [0; 6],
        };
        match ready.cause {
            Cause::Tick(tick) => {
                source.tick = tick.number;
                source.tick_due_ns = tick.due.0;
                source.ticks_missed = tick.missed;
            }
            Cause::Descriptor(readiness) => {
                source.readable = readiness.readable.into();
                source.writable = readiness.writable.into();
            }
            // The tag tells the program which one it is.
            _ => {}
        }
        source
    }
}

/// Makes an empty wait set. It waits for subscribers, servers, calls, publishers with room, timers and descriptors, in
/// one thread without callbacks. Each source has a tag of the program's choice, which must be unique in the set.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_new(set: Option<&mut MaybeUninit<Option<Box<WaitSet>>>>) -> Status {
    guard(|| {
        let set = vacant(set, "set")?;
        *set = Some(Box::new(WaitSet {
            set: sm2_node::WaitSet::new()?,
            sources: HashMap::new(),
        }));
        Ok(())
    })
}

/// Frees a wait set; NULL is ignored. Its sources stay as they are.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_free(set: Option<Box<WaitSet>>) {
    guard_drop(set);
}

/// Adds a subscriber. It is reported again and again until `sm2_subscriber_recv()` with the limit 0 finds nothing. It
/// may be freed while it is in the set, and is not reported then.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_subscriber(
    set: Option<&mut WaitSet>,
    subscriber: Option<&Subscriber>,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        set.add_waitable(&given(subscriber, "subscriber")?.0, tag)
    })
}

/// Adds a server. It is reported again and again until `sm2_server_recv()` with the limit 0 finds nothing. It may be
/// freed while it is in the set.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_server(
    set: Option<&mut WaitSet>,
    server: Option<&Server>,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        set.add_waitable(&given(server, "server")?.0, tag)
    })
}

/// Adds a publisher. It is reported while every reliable subscriber has room: then call `sm2_publisher_try_publish()`.
/// A program adds it while it has a message that found no room, and then removes it.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_publisher(
    set: Option<&mut WaitSet>,
    publisher: Option<&Publisher>,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        set.add_waitable(&*given(publisher, "publisher")?.0, tag)
    })
}

/// Adds a pending call. It is reported once, when it has a result or its deadline has passed; then it leaves the set,
/// and `sm2_call_try_wait()` returns the result.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use or the call is spent.
///
/// Threads: one at a time for each set and call.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_call(
    set: Option<&mut WaitSet>,
    call: Option<&Call>,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        let call = given(call, "call")?.pending()?;
        set.add(tag, true, |set| set.add(call, tag))
    })
}

/// Adds a timer that ticks once in each period of `period_ns` nanoseconds, without drift. With `burst`, each missed
/// tick is reported; otherwise only the newest, with the number of those before it.
///
/// Errors: `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_timer(
    set: Option<&mut WaitSet>,
    period_ns: u64,
    burst: bool,
    tag: u64,
) -> Status {
    guard(|| {
        let timer = Timer::every(duration(period_ns)).missed_ticks(missed(burst));
        let set = given(set, "set")?;
        set.add(tag, false, |set| Ok(set.add_timer(timer, tag)))
    })
}

/// Adds a timer that ticks `frequency` times in each second, without drift, also if a second is not a multiple of the
/// period. `burst` as for `sm2_wait_set_add_timer()`.
///
/// Errors: `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_timer_hz(
    set: Option<&mut WaitSet>,
    frequency: u32,
    burst: bool,
    tag: u64,
) -> Status {
    guard(|| {
        let timer = Timer::hz(frequency).missed_ticks(missed(burst));
        let set = given(set, "set")?;
        set.add(tag, false, |set| Ok(set.add_timer(timer, tag)))
    })
}

/// Adds a timer that ticks once, `delay_ns` nanoseconds from now. Then it leaves the set.
///
/// Errors: `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_timer_once(
    set: Option<&mut WaitSet>,
    delay_ns: u64,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        let timer = Timer::once(duration(delay_ns));
        set.add(tag, true, |set| Ok(set.add_timer(timer, tag)))
    })
}

/// Adds a descriptor of the program, level-triggered: reported while reading (`readable`) or writing (`writable`) does
/// not block, or after a hang-up. The descriptor must stay open until it is removed or the set is freed.
///
/// Errors: `SM2_IO` (such as `EEXIST` for a descriptor that is in the set, and `EPERM` for a regular file),
/// `SM2_MISUSE`, also if the tag is in use.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_add_descriptor(
    set: Option<&mut WaitSet>,
    fd: c_int,
    readable: bool,
    writable: bool,
    tag: u64,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        let interest = match (readable, writable) {
            (true, true) => Interest::Both,
            (false, true) => Interest::Writable,
            (true, false) => Interest::Readable,
            (false, false) => {
                return Err(Failure::misuse(
                    "a descriptor is added for nothing: pass true for 'readable' or 'writable'",
                ));
            }
        };
        if fd < 0 {
            return Err(Failure::misuse(format!("{fd} is not a descriptor")));
        }
        // SAFETY: the number is not -1, and the header demands that the descriptor stays open while it is in the set.
        let fd = unsafe { BorrowedFd::borrow_raw(fd) };
        set.add(tag, false, |set| set.add_descriptor(fd, interest, tag))
    })
}

/// Ends every wait of the set with `SM2_SHUTDOWN` once this shutdown is requested, also if a source is ready.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_end_with(
    set: Option<&mut WaitSet>,
    shutdown: Option<&Shutdown>,
) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        Ok(set.set.end_with(&given(shutdown, "shutdown")?.0)?)
    })
}

/// Drives a node without a background thread during every wait, if no source of the set belongs to it.
///
/// Errors: `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_drive(set: Option<&mut WaitSet>, node: Option<&Node>) -> Status {
    guard(|| Ok(given(set, "set")?.set.drive(&given(node, "node")?.0)?))
}

/// Removes the source with this tag. It is not reported any more, even if it was ready.
///
/// Errors: `SM2_MISUSE`, also if no source of the set has the tag.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_remove(set: Option<&mut WaitSet>, tag: u64) -> Status {
    guard(|| {
        let set = given(set, "set")?;
        let source = set.sources.remove(&tag).ok_or_else(|| {
            Failure::misuse(format!("no source of the wait set has the tag {tag}"))
        })?;
        set.set.remove(source.key);
        Ok(())
    })
}

/// Waits until a source is ready, for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
/// `SM2_FOREVER`. Stores its tag, and the tick of a timer, in `ready`. Sources that are ready at the same time are
/// reported in turn.
///
/// Errors: `SM2_TIMED_OUT`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: one at a time for each set.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_wait_set_wait(
    set: Option<&mut WaitSet>,
    timeout_ns: u64,
    ready: *mut ReadySource,
) -> Status {
    guard(|| {
        let place = Out(ready).required("ready")?;
        let set = given(set, "set")?;
        let ready = match timeout_ns {
            0 => set.set.try_wait()?,
            FOREVER => Some(set.set.wait()?),
            ns => set.set.wait_timeout(duration(ns))?,
        };
        let ready = ready.ok_or(Failure::TIMED_OUT)?;
        set.reported(ready.tag);
        place.write(&ready.into());
        Ok(())
    })
}

const fn missed(burst: bool) -> MissedTicks {
    match burst {
        true => MissedTicks::Burst,
        false => MissedTicks::Skip,
    }
}
