//! Messages of durable topics until the network has acknowledged them: a spool and its store.

use std::collections::BTreeMap;
use std::path::Path;

use sm2_proto::{Instant, Name};

use crate::spool::{Id, Limits, Output, Spool, SpoolCounts};
use crate::store::{Store, StoreError};
use crate::{Durable, Origin};

/// A [`Spool`] whose messages are in the MCAP files of a folder.
///
/// Messages that the bridge had not handed over when its program ended are sent after the next start, with their old
/// [`Origin`]; some that were handed over may be sent again.
#[derive(Debug)]
pub struct Outbox {
    spool: Spool,
    store: Store,
    /// Messages that were sent and have no fate yet.
    sent: BTreeMap<Id, (Name, Origin)>,
}

impl Outbox {
    /// Opens the folder, which is made if it is missing. No other outbox may use it. `wall` is the present time, in
    /// nanoseconds since 1970 (UTC).
    ///
    /// # Errors
    ///
    /// See [`StoreError`].
    pub fn open(
        folder: &Path,
        limits: Limits,
        now: Instant,
        wall: u64,
    ) -> Result<Self, StoreError> {
        let mut spool = Spool::new(limits);
        let store = Store::open(folder, &mut spool, now, wall)?;
        Ok(Self {
            spool,
            store,
            sent: BTreeMap::new(),
        })
    }

    /// Takes a message.
    ///
    /// # Errors
    ///
    /// The message cannot be stored. It counts as refused then.
    pub fn offer(&mut self, message: Durable, now: Instant) -> Result<(), StoreError> {
        let id = self.spool.offer(message.payload.len() as u64, now);
        let stored = self.store.put(id, message);
        if stored.is_err() {
            self.spool.reject(id);
        }
        stored
    }

    /// The network is there.
    pub const fn connect(&mut self) {
        self.spool.connect();
    }

    /// The network is away: what was in flight will be sent again.
    pub fn disconnect(&mut self, now: Instant) {
        self.spool.disconnect(now);
    }

    /// The network has acknowledged a message. Without effect for one that was not sent, or has its fate.
    pub fn acknowledge(&mut self, topic: &Name, origin: &Origin) {
        // Mostly the oldest one.
        let mut sent = self.sent.iter();
        if let Some((id, _)) = sent.find(|(_, (its, from))| its == topic && from == origin) {
            self.spool.acknowledge(*id);
        }
    }

    /// The next message to send. Call it until it returns `None`, after each event and at the
    /// [deadline](Self::deadline).
    ///
    /// # Errors
    ///
    /// A message is lost, which counts as refused, or a file cannot be removed. The next call goes on.
    pub fn poll(&mut self, now: Instant) -> Result<Option<Durable>, StoreError> {
        while let Some(output) = self.spool.poll(now) {
            match output {
                Output::End(id, _) => {
                    self.sent.remove(&id);
                    self.store.end(id)?;
                }
                Output::Send(id) => match self.store.get(id) {
                    Ok(message) => {
                        let key = (message.topic.clone(), message.origin.clone());
                        self.sent.insert(id, key);
                        return Ok(Some(message));
                    }
                    Err(error) => {
                        self.spool.reject(id);
                        return Err(error);
                    }
                },
            }
        }
        Ok(None)
    }

    /// The time when [`poll`](Self::poll) has a message, unless an event comes before.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.spool.deadline()
    }

    /// The account.
    #[must_use]
    pub fn counts(&self) -> SpoolCounts {
        self.spool.counts()
    }
}
