//! Cyclone DDS and Fast DDS, as packaged by Debian, and SM2 in C++.
//!
//! Their interfaces are C and C++. `bench/dds/` has a small library for each, which implements
//! `bench_dds.h` and is compiled on first use. The loops, the payload and its check are the same as
//! for every other peer.

use std::{
    ffi::{CString, c_int, c_void},
    slice,
};

use crate::peers::{
    contract::{Flow, Handler, Peer, PeerError, Publish, Subscribe},
    sm2::{self, Sm2},
};
use crate::{
    clock::now_ns,
    job::{Channel, Domain},
};

mod build;
mod library;

use library::{Library, RawTopic};

/// Checks that the peer's library can be compiled on this machine.
///
/// # Errors
///
/// The reason why it cannot be compiled, and the packages that it needs.
pub fn available(peer: &str) -> Result<(), String> {
    build::built(vendor(peer).0).map(drop)
}

/// The vendor and the mode of a peer: the parts of its name before and after the dash.
fn vendor(peer: &str) -> (&str, &str) {
    peer.split_once('-').unwrap_or((peer, ""))
}

/// A participant.
pub struct Dds {
    library: &'static Library,
    participant: *mut c_void,
}

impl Peer for Dds {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    /// Runs the Manager of `sm2-cpp`.
    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        Sm2::serve(domain, ready)
    }

    fn open(domain: &Domain, _: &str, _: bool) -> Result<Self, PeerError> {
        let (vendor, mode) = vendor(&domain.peer);
        let path = build::built(vendor).map_err(PeerError::caused("build its library"))?;
        let library = Library::load(&path)?;
        let mode = match vendor {
            "sm2" => text(&sm2::socket(domain).to_string_lossy())?,
            _ => text(mode)?,
        };
        // A domain number of its own for each run, so that runs at the same time do not connect;
        // DDS has 232 domains.
        let number = u32::from(domain.port) % 200;
        // SAFETY: the function is `bench_open` of `bench_dds.h`, and the text outlives the call.
        let participant = unsafe { (library.open)(number, mode.as_ptr()) };
        Ok(Self {
            participant: library.checked(participant, "open a participant")?,
            library,
        })
    }

    fn publisher(&self, channel: &Channel) -> Result<Sender, PeerError> {
        let name = text(&channel.name)?;
        let raw = RawTopic::new(channel, &name);
        // SAFETY: the participant lives as long as the process, and the channel outlives the call.
        let publisher = unsafe { (self.library.publish_on)(self.participant, &raw) };
        Ok(Sender {
            publisher: self.library.checked(publisher, "make a publisher")?,
            library: self.library,
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let name = text(&channel.name)?;
        let raw = RawTopic::new(channel, &name);
        // SAFETY: the participant lives as long as the process, and the channel outlives the call.
        let subscriber = unsafe { (self.library.subscribe_to)(self.participant, &raw) };
        Ok(Receiver {
            subscriber: self.library.checked(subscriber, "make a subscriber")?,
            library: self.library,
            handler,
        })
    }
}

fn text(text: &str) -> Result<CString, PeerError> {
    CString::new(text).map_err(PeerError::caused("hand over a name"))
}

/// A publisher.
pub struct Sender {
    library: &'static Library,
    publisher: *mut c_void,
}

// SAFETY: a DDS entity may be used on every thread, and a `Sender` is not shared.
unsafe impl Send for Sender {}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        let mut write = Some(write);
        let call = call_write(&write);
        // SAFETY: the publisher lives as long as the process. `call` gets a pointer to `write`,
        // which outlives the call.
        let code = unsafe {
            (self.library.publish)(
                self.publisher,
                len,
                call,
                std::ptr::from_mut(&mut write).cast(),
            )
        };
        self.library.done(code, "publish").map(drop)
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        // SAFETY: the publisher lives as long as the process.
        let count = unsafe { (self.library.matched)(self.publisher) };
        self.library.done(count, "look for subscribers")
    }
}

/// A C function that calls a closure of this type.
fn call_write<W: FnOnce(&mut [u8])>(_: &Option<W>) -> library::Write {
    unsafe extern "C" fn call<W: FnOnce(&mut [u8])>(
        context: *mut c_void,
        message: *mut u8,
        len: usize,
    ) {
        // SAFETY: `context` points to the closure in `publish`, and nothing else refers to it.
        let write = unsafe { &mut *context.cast::<Option<W>>() };
        if let Some(write) = write.take() {
            // SAFETY: the library passes `len` initialized bytes, for the duration of this call.
            write(unsafe { slice::from_raw_parts_mut(message, len) });
        }
    }
    call::<W>
}

/// A subscriber.
pub struct Receiver<H> {
    library: &'static Library,
    subscriber: *mut c_void,
    handler: H,
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        let timeout_ns = until_ns.saturating_sub(now_ns());
        // SAFETY: the subscriber lives as long as the process. `call_read` gets a pointer to the
        // handler, which outlives the call, and runs on this thread.
        let code = unsafe {
            (self.library.pump)(
                self.subscriber,
                timeout_ns,
                call_read::<H>,
                std::ptr::from_mut(&mut self.handler).cast(),
            )
        };
        self.library.done(code, "receive").map(drop)
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.handler)
    }
}

unsafe extern "C" fn call_read<H: Handler>(
    context: *mut c_void,
    message: *const u8,
    len: usize,
) -> c_int {
    // SAFETY: `context` points to the handler in `pump`, and nothing else refers to it during the
    // call.
    let handler = unsafe { &mut *context.cast::<H>() };
    // SAFETY: the library passes `len` initialized bytes, and must not change them during this
    // call. If it overwrites a loaned message nevertheless, the check finds the message torn.
    let message = unsafe { slice::from_raw_parts(message, len) };
    c_int::from(handler.message(message) == Flow::Return)
}
