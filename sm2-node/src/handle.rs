//! What all four kinds of interface have in common.

mod many;

use std::borrow::Cow;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

use bytes::Bytes;
use sm2_io::{Blank, Epoll};
use sm2_proto::control::Peer;
use sm2_proto::limits::MESSAGE_MAX;
use sm2_proto::link::Delivery;
use sm2_proto::node;
use sm2_proto::{Contract, Instant, InterfaceId, Name, Refusal, TypeId};

use crate::driver::{
    Bell, Forms, Full, Inner, Interface, LinkStatus, Needs, NoSlot, Reserved, Shared, State, Taken,
    Tools, Topic, Until,
};
use crate::payload::MessageBytes;
use crate::pool::Lease;
use crate::schema::check_schema;
use crate::stock;
use crate::{DeclareError, RecvError, StoreError, Wait, WaitError};

/// A declared interface, until it is dropped.
#[derive(Debug)]
pub(crate) struct Handle {
    pub(crate) shared: Arc<Shared>,
    pub(crate) id: InterfaceId,
    pub(crate) name: Name,
    matched: usize,
    pool_limit_bytes: u64,
    /// Made when somebody asks for a descriptor; none if that failed.
    bell: OnceLock<Option<Bell>>,
    /// Tasks that wait for the descriptor, to be told when somebody else silences it: the
    /// runtime learns of changes alone, and this one is over before it asks.
    #[cfg(feature = "tokio")]
    pub(crate) silenced: Arc<tokio::sync::Notify>,
}

impl Handle {
    /// Declares an interface, and waits for the Manager's word. The texts of its types go along,
    /// of those that have one.
    pub(crate) fn declare(
        shared: &Arc<Shared>,
        contract: Contract,
        pool_limit_bytes: u64,
        schemas: impl IntoIterator<Item = (TypeId, Option<String>)>,
    ) -> Result<Self, DeclareError> {
        contract.check_qos()?;
        let name = contract.name().clone();
        let mut inner = shared.driven();
        for (data, text) in schemas {
            register_schema(&mut inner, data, text, &shared.epoll);
        }
        let declared = inner.declare(contract.clone(), pool_limit_bytes, &shared.epoll);
        drop(inner);
        let id = match declared {
            Ok(id) => id,
            Err(error) => return Err(refused_here(error, contract)),
        };
        // From here on dropping it tells the Manager.
        let mut handle = Self {
            shared: Arc::clone(shared),
            id,
            name: name.clone(),
            matched: 0,
            pool_limit_bytes,
            bell: OnceLock::new(),
            #[cfg(feature = "tokio")]
            silenced: Arc::default(),
        };
        let until = until(Some(shared.patience));
        let answer = shared.wait(Topic::Interface(id), until, |inner| {
            match &inner.interfaces.get(&id)?.state {
                State::Declaring => None,
                state => Some(state.clone()),
            }
        });
        match answer.map_err(DeclareError::Io)? {
            Some(State::Live { matches }) => {
                handle.matched = matches as usize;
                Ok(handle)
            }
            Some(State::Refused(reason)) => Err(refused(reason, contract)),
            Some(State::Declaring) | None => Err(match shared.lock().away() {
                Some(end) => DeclareError::ManagerGone { name, end },
                None => DeclareError::TimedOut { name },
            }),
        }
    }

    /// How long unused memory is kept, and what is there before any message.
    pub(crate) fn keep(&mut self, idle: Duration, reserved: Option<Reserved>) {
        let bytes = reserved.as_ref().map_or(0, Reserved::bytes);
        self.pool_limit_bytes = self.pool_limit_bytes.saturating_add(bytes);
        self.with_idle(|interface, _| {
            interface.outbox.keep_idle(idle);
            if let Some(reserved) = reserved {
                interface.outbox.adopt(reserved);
            }
        });
    }

    /// Whether the Manager that is there has it.
    pub(crate) fn is_registered(&self) -> bool {
        self.shared.driven().is_registered(self.id)
    }

    pub(crate) const fn matched(&self) -> usize {
        self.matched
    }

    /// Drives the node and changes the interface.
    pub(crate) fn with<R>(&self, change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R) -> R {
        (self.shared.with(self.id, change)).expect("the interface lives as long as its handle")
    }

    /// The same, but the node is driven only if it is time to, as long as all links have rings.
    pub(crate) fn with_due<R>(
        &self,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> R {
        (self.shared.with_due(self.id, change)).expect("the interface lives as long as its handle")
    }

    /// Changes the interface, without driving the node.
    pub(crate) fn with_idle<R>(
        &self,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> R {
        (self.shared.with_idle(self.id, change)).expect("the interface lives as long as its handle")
    }

    pub(crate) fn links(&self) -> Vec<LinkStatus> {
        self.with(|interface, _| interface.statuses())
    }

    /// Waits until `wanted` links are open.
    pub(crate) fn wait_open(
        &self,
        wanted: usize,
        timeout: Option<Duration>,
    ) -> Result<(), WaitError> {
        let mut found = 0;
        let topic = Topic::Interface(self.id);
        let waited = self.shared.wait(topic, until(timeout), |inner| {
            found = inner.interfaces.get(&self.id)?.open_links();
            (found >= wanted).then_some(())
        });
        if waited.map_err(WaitError::Io)?.is_some() {
            return Ok(());
        }
        let kind = self.with_idle(|interface, _| interface.contract.kind().counterpart());
        Err(match self.shared.lock().away() {
            Some(end) => WaitError::ManagerGone {
                kind,
                found,
                wanted,
                end,
            },
            None => WaitError::TimedOut {
                kind,
                found,
                wanted,
            },
        })
    }

    /// Waits until there is a message. `None`: the time is over. Without a Manager and without
    /// links it waits for these to come back.
    pub(crate) fn receive(
        &self,
        way: Wait,
        until: Until,
        take: impl Fn(&mut Interface, &mut Tools<'_>) -> Result<Option<Taken>, Full>,
    ) -> Result<Option<Received>, RecvError> {
        let epoll = &self.shared.epoll;
        let topic = Topic::Interface(self.id);
        let found = self.shared.wait_as(way, topic, until, |inner| {
            self.look(inner, |inner| {
                let taken = inner.with(self.id, epoll, &take)?;
                taken.map_err(RecvError::from).transpose()
            })
        });
        match found.map_err(RecvError::Io)?.transpose()? {
            Some(taken) => self.open_for(taken).map(Some),
            None => Ok(None),
        }
    }

    fn open_for(&self, taken: Taken) -> Result<Received, RecvError> {
        let receipt = self.receipt(&taken);
        self.open_with(taken, receipt).map_err(RecvError::from)
    }

    /// Puts a message where the links that need it can have it.
    pub(crate) fn store(
        &self,
        bytes: Cow<'_, [u8]>,
        inline_max: usize,
        needs: Needs,
    ) -> Result<Forms, StoreError> {
        self.store_with(bytes, inline_max, needs, |_| None)
    }

    /// The same, with memory for a sealed message of some length, if that is ready.
    pub(crate) fn store_with(
        &self,
        bytes: Cow<'_, [u8]>,
        inline_max: usize,
        needs: Needs,
        ready: impl FnOnce(usize) -> Option<Blank>,
    ) -> Result<Forms, StoreError> {
        let mut forms = Forms::default();
        if needs.nobody() {
            return Ok(forms);
        }
        let short = bytes.len() <= inline_max;
        // First what can fail and needs no undoing.
        if needs.sealed && !short {
            check_len(bytes.len() as u64)?;
            forms.sealed = Some(stock::seal(ready(bytes.len()), &bytes)?);
        }
        if needs.ring || (needs.pooled && !short) {
            let mut lease = self.lease(bytes.len())?;
            lease.memory.bytes_mut(bytes.len()).copy_from_slice(&bytes);
            forms.pooled = Some(lease);
        }
        if short && needs.inline() {
            forms.inline = Some(match bytes {
                Cow::Borrowed(bytes) => Bytes::copy_from_slice(bytes),
                Cow::Owned(bytes) => bytes.into(),
            });
        }
        Ok(forms)
    }

    /// A slot for `len` bytes.
    pub(crate) fn lease(&self, len: usize) -> Result<Lease<sm2_io::Slot>, StoreError> {
        check_len(len as u64)?;
        let now = sm2_io::clock::now();
        let lease = self.with_idle(|interface, tools| {
            let lease = interface.outbox.lease(len as u64);
            interface.rest(now, tools);
            lease
        });
        let mut lease = lease.map_err(|error| match error {
            NoSlot::Full => StoreError::PoolFull {
                len: len as u64,
                limit_bytes: self.pool_limit_bytes,
            },
            NoSlot::Io(error) | NoSlot::Lock(error) => StoreError::Io(error),
        })?;
        // Not under the node's lock: the first time it takes long.
        lease.memory.warm(len);
        Ok(lease)
    }

    /// Makes a message readable that was taken. If that is not possible, its link is closed.
    pub(crate) fn open(&self, taken: Taken) -> io::Result<Received> {
        let receipt = self.receipt(&taken);
        self.open_with(taken, receipt).map_err(|it| it.source)
    }

    #[inline]
    fn open_with(&self, taken: Taken, receipt: Receipt) -> Result<Received, Unreadable> {
        let Taken {
            token,
            peer,
            delivery,
            source,
        } = taken;
        // SAFETY: only `receipt`, or the `Lent` of its batch, releases the message. `Received`,
        // `Sample`, `Request` and `Reply` drop the bytes before the receipt, `Lent` is dropped
        // after all of them, and none gives the bytes away.
        #[allow(unsafe_code, reason = "the receipt is here: see the SAFETY text")]
        let opened = unsafe { source.open() };
        match opened {
            Ok(bytes) => Ok(Received {
                peer,
                delivery,
                bytes,
                receipt,
            }),
            Err(source) => {
                self.with_idle(|interface, tools| interface.unreadable(token, tools));
                Err(Unreadable { peer, source })
            }
        }
    }

    fn receipt(&self, taken: &Taken) -> Receipt {
        Receipt {
            shared: Arc::downgrade(&self.shared),
            interface: self.id,
            token: taken.token,
            sequence: taken.delivery.sequence,
        }
    }

    /// What `look` finds. If that is nothing, the descriptor, if there is one, is readable again when
    /// something comes; since something may have come meanwhile, it looks once more then.
    pub(crate) fn look<T>(
        &self,
        inner: &mut Inner,
        mut look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> Option<T> {
        look(inner).or_else(|| match self.silence(inner) {
            true => look(inner),
            false => None,
        })
    }

    /// Whether to look once more.
    pub(crate) fn silence(&self, inner: &mut Inner) -> bool {
        let Some(Some(bell)) = self.bell.get() else {
            return false;
        };
        if bell.silence(inner) {
            #[cfg(feature = "tokio")]
            self.silenced.notify_waiters();
        }
        inner.park(Topic::Interface(self.id))
    }

    /// What a program can poll: see [`Bell`].
    pub(crate) fn descriptor(&self) -> BorrowedFd<'_> {
        let make = || match Bell::new(&self.shared, self.id) {
            Ok(bell) => Some(bell),
            Err(error) => {
                tracing::warn!(%error, name = %self.name, "no descriptor of its own: the node's is used");
                None
            }
        };
        match self.bell.get_or_init(make) {
            Some(bell) => bell.as_fd(),
            None => self.shared.epoll.as_fd(),
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        let mut inner = self.shared.driven();
        if let Some(Some(bell)) = self.bell.get() {
            bell.remove(&mut inner);
        }
        inner.withdraw(self.id, &self.shared.epoll);
    }
}

/// A message that the program holds.
#[derive(Debug)]
pub(crate) struct Received {
    pub(crate) peer: Arc<Peer>,
    pub(crate) delivery: Delivery,
    pub(crate) bytes: MessageBytes,
    /// Last: what is given back is not looked at any more.
    pub(crate) receipt: Receipt,
}

/// A message that cannot be read: this machine is out of memory.
struct Unreadable {
    peer: Arc<Peer>,
    source: io::Error,
}

/// That a message is to be given back. It neither keeps the node alive nor its interface.
#[derive(Debug)]
pub(crate) struct Receipt {
    shared: Weak<Shared>,
    interface: InterfaceId,
    token: u64,
    sequence: u64,
}

impl Receipt {
    /// That of a message that somebody else gives back.
    const fn none() -> Self {
        Self {
            shared: Weak::new(),
            interface: InterfaceId(0),
            token: 0,
            sequence: 0,
        }
    }

    /// The token of its link.
    pub(crate) const fn token(&self) -> u64 {
        self.token
    }
}

impl Drop for Receipt {
    //= SM2-MSG-005
    fn drop(&mut self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.with_idle(self.interface, |interface, tools| {
                interface.give_back(self.token, self.sequence, tools);
            });
        }
    }
}

impl Interface {
    /// Gives back memory that was not used for long. Cheap: it may be called with every message.
    pub(crate) fn rest(&mut self, now: Instant, tools: &mut Tools<'_>) {
        self.outbox.rest(now);
        self.detach_segments(tools);
    }
}

/// The moment `timeout` from now.
pub(crate) fn until(timeout: Option<Duration>) -> Option<Instant> {
    timeout.map(|timeout| sm2_io::clock::now().after(timeout))
}

const fn check_len(len: u64) -> Result<(), StoreError> {
    if len > MESSAGE_MAX {
        return Err(StoreError::TooLong { len });
    }
    Ok(())
}

/// The Manager did not grant a declaration.
fn refused(reason: Refusal, contract: Contract) -> DeclareError {
    let kind = contract.kind();
    let name = contract.name().clone();
    match (reason, contract) {
        (
            Refusal::TopicType { theirs },
            Contract::Publisher { data: ours, .. }
            | Contract::Subscriber {
                data: Some(ours), ..
            },
        ) => DeclareError::TypeMismatch {
            topic: name,
            kind,
            ours,
            theirs,
        },
        (
            Refusal::ServiceType {
                request: theirs,
                reply: their_reply,
            },
            Contract::Server { request, reply, .. }
            | Contract::Client {
                types: Some((request, reply)),
                ..
            },
        ) => DeclareError::ServiceMismatch {
            service: name,
            kind,
            ours: Box::new((request, reply)),
            theirs: Box::new((theirs, their_reply)),
        },
        (Refusal::Quota { quota, limit }, _) => DeclareError::Quota { name, quota, limit },
        (reason, _) => DeclareError::Refused { name, reason },
    }
}

/// The session's machine did not take a declaration. What it could object to was checked.
fn refused_here(error: node::Error, contract: Contract) -> DeclareError {
    debug_assert!(false, "{error}");
    DeclareError::ManagerGone {
        name: contract.name().clone(),
        end: node::End::Eof,
    }
}

/// Lets tools know what a type looks like. One whose text is not its own, by an
/// implementation by hand, is left out: the Manager would take it for a violation.
fn register_schema(inner: &mut Inner, data: TypeId, text: Option<String>, epoll: &Epoll) {
    let Some(text) = text else { return };
    match check_schema(&data, &text) {
        Ok(()) => inner.register_schema(data, text, epoll),
        Err(error) => tracing::warn!(%error, "tools will not know this type"),
    }
}

impl From<Unreadable> for RecvError {
    fn from(Unreadable { peer, source }: Unreadable) -> Self {
        Self::Map {
            publisher: peer.name.clone(),
            source,
        }
    }
}

impl From<Full> for RecvError {
    fn from(Full { error, peer }: Full) -> Self {
        Self::TooManyBorrowed {
            held: error.max_borrowed,
            publisher: peer.name.clone(),
        }
    }
}
