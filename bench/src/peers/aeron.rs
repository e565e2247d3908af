//! Aeron IPC: an exclusive publication per channel. A subscriber polls and never sleeps.
//!
//! The daemon is a media driver. It makes the logs of the publications in shared memory, and moves
//! their limits as the subscribers read. Messages do not pass through it. As in Aeron's samples for
//! low latency, logs are not sparse, and both sides touch all pages before the first message.

use std::{
    ffi::{CStr, CString},
    hint, mem,
    time::Duration,
};

use rusteron_media_driver::{
    Aeron as Client, AeronCError, AeronContext, AeronControlledFragmentClosureAssembler,
    AeronDriver, AeronDriverContext, AeronExclusivePublication, AeronHeader, AeronOfferError,
    AeronSubscription, Handlers,
    bindings::{
        aeron_controlled_fragment_handler_action_en as Action,
        aeron_threading_mode_enum as ThreadingMode,
    },
};

use super::contract::{Flow, Handler, Peer, PeerError, Publish, Subscribe, TIMEOUT_NS};
use crate::{
    clock::now_ns,
    control::{Stage, wait_for},
    job::{Channel, Domain},
};

/// The channel of all streams, with the largest fragments that Aeron has. A message of up to
/// 65,472 bytes is written in place; a longer one is copied in fewer fragments than by default.
const URI: &CStr = c"aeron:ipc?mtu=65504";

/// Timeout of a declaration.
const TIMEOUT: Duration = Duration::from_nanos(TIMEOUT_NS);

/// The number of attempts between two readings of the clock.
const ATTEMPTS: u32 = 256;

/// The largest number of fragments that one poll takes, as in Aeron's samples.
const FRAGMENTS: usize = 10;

fn failed(action: &'static str) -> impl FnOnce(AeronCError) -> PeerError {
    PeerError::caused(action)
}

/// A client of the media driver.
pub struct Aeron(Client);

impl Peer for Aeron {
    type Publisher = Sender;
    type Subscriber<H: Handler> = Receiver<H>;

    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        let _driver = launch(domain).map_err(failed("launch the media driver"))?;
        ready();
        wait_for(Stage::End);
        Ok(())
    }

    fn open(domain: &Domain, _: &str, _: bool) -> Result<Self, PeerError> {
        connect(domain)
            .map(Self)
            .map_err(failed("connect to the media driver"))
    }

    fn publisher(&self, channel: &Channel) -> Result<Sender, PeerError> {
        let publication = self
            .0
            .add_exclusive_publication(URI, stream_id(channel), TIMEOUT)
            .map_err(failed("add a publication"))?;
        Ok(Sender {
            longest_claim: publication
                .max_payload_length()
                .map_err(failed("read the constants of a publication"))?,
            publication,
            message: vec![0; channel.max_len],
        })
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Receiver<H>, PeerError> {
        let subscription = self
            .0
            .add_subscription(
                URI,
                stream_id(channel),
                Handlers::NONE,
                Handlers::NONE,
                TIMEOUT,
            )
            .map_err(failed("add a subscription"))?;
        Ok(Receiver {
            subscription,
            assembler: AeronControlledFragmentClosureAssembler::new()
                .map_err(failed("make a fragment assembler"))?,
            delivery: Delivery {
                handler,
                returned: false,
            },
        })
    }
}

fn launch(domain: &Domain) -> Result<AeronDriver, AeronCError> {
    let context = AeronDriverContext::new()?;
    context.set_dir(&folder(domain)?)?;
    // IPC has no network, so that only the conductor has work: one thread does as much as three.
    context.set_threading_mode(ThreadingMode::AERON_THREADING_MODE_SHARED)?;
    context.set_term_buffer_sparse_file(false)?;
    let driver = AeronDriver::new(&context)?;
    driver.start(false)?;
    Ok(driver)
}

fn connect(domain: &Domain) -> Result<Client, AeronCError> {
    let context = AeronContext::new()?;
    context.set_dir(&folder(domain)?)?;
    context.set_pre_touch_mapped_memory(true)?;
    let client = Client::new(&context)?;
    client.start()?;
    Ok(client)
}

/// The folder of the media driver. The director removes it with the folder of the case.
fn folder(domain: &Domain) -> Result<CString, AeronCError> {
    let folder = domain.dir.join("aeron");
    CString::new(folder.as_os_str().as_encoded_bytes())
        .map_err(|error| AeronCError::with_message(-1, error.to_string()))
}

/// The stream of a channel: the FNV-1a hash of its name, the same in all processes.
fn stream_id(channel: &Channel) -> i32 {
    let hash = channel.name.bytes().fold(0x811c_9dc5_u32, |hash, byte| {
        (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
    });
    hash.cast_signed()
}

/// A publisher.
pub struct Sender {
    publication: AeronExclusivePublication,
    /// The longest message that is one fragment, which is written in place.
    longest_claim: usize,
    /// Memory for writing a longer message. The publication copies it in fragments.
    message: Vec<u8>,
}

// SAFETY: a `Sender` is never moved to another thread. `Handler` requires `Send` for peers that
// call handlers on threads of their own, and the handler of an echo holds a `Sender`. `Receiver`
// below calls its handler on the thread that made both.
unsafe impl Send for Sender {}

impl Publish for Sender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        if len <= self.longest_claim {
            let mut claim = retried(|| self.publication.try_claim_owned(len))?;
            write(claim.data());
            claim.commit().map_err(failed("commit a message"))?;
        } else {
            self.message.resize(len, 0);
            write(&mut self.message);
            retried(|| self.publication.offer(&self.message))?;
        }
        Ok(())
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        Ok(usize::from(self.publication.is_connected()))
    }
}

/// Repeats an attempt to publish while the subscriber is behind or its log is about to rotate.
fn retried<T>(mut attempt: impl FnMut() -> Result<T, AeronOfferError>) -> Result<T, PeerError> {
    let mut until_ns = None;
    loop {
        for _ in 0..ATTEMPTS {
            match attempt() {
                Ok(done) => return Ok(done),
                Err(error) if error.is_retryable() => hint::spin_loop(),
                Err(error) => return Err(PeerError::new("publish", error.to_string())),
            }
        }
        let now = now_ns();
        if now > *until_ns.get_or_insert(now + TIMEOUT_NS) {
            return Err(PeerError::new(
                "publish",
                "the subscriber made no room in time",
            ));
        }
    }
}

/// A subscriber.
pub struct Receiver<H> {
    subscription: AeronSubscription,
    assembler: AeronControlledFragmentClosureAssembler,
    delivery: Delivery<H>,
}

/// The handler of a subscriber.
struct Delivery<H> {
    handler: H,
    /// True when the handler has returned [`Flow::Return`].
    returned: bool,
}

impl<H: Handler> Delivery<H> {
    fn message(&mut self, message: &[u8], _: AeronHeader) -> Action {
        match self.handler.message(message) {
            Flow::Continue => Action::AERON_ACTION_CONTINUE,
            Flow::Return => {
                self.returned = true;
                Action::AERON_ACTION_BREAK
            }
        }
    }
}

impl<H: Handler> Subscribe<H> for Receiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        while now_ns() < until_ns {
            for _ in 0..ATTEMPTS {
                let fragments = self
                    .assembler
                    .poll(
                        &self.subscription,
                        &mut self.delivery,
                        Delivery::message,
                        FRAGMENTS,
                    )
                    .map_err(failed("poll"))?;
                if mem::take(&mut self.delivery.returned) {
                    return Ok(());
                }
                if fragments == 0 {
                    hint::spin_loop();
                }
            }
        }
        Ok(())
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.delivery.handler)
    }
}
