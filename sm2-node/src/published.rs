use crate::PublishError;

/// The result of one publication.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// How many links accepted the message.
    pub links: usize,
    /// How many reliable links miss this message. Links that had no room until the deadline, or hold too much of
    /// the pool, owe from then on: nothing waits for them (SM2-QOS-003, SM2-QOS-007). The others do not accept
    /// messages of this length: see [`too_long`](Self::too_long).
    pub missed: usize,
    /// How many links, best-effort ones included, miss this message because it is longer than the
    /// [`max_len`](crate::SubscriberBuilder::max_len) of their subscribers (SM2-QOS-008).
    pub too_long: usize,
}

impl Published {
    /// Returns an error if a reliable subscriber missed the message.
    ///
    /// # Errors
    ///
    /// [`PublishError::TooLong`] if the message is longer than a subscriber accepts; otherwise
    /// [`PublishError::DeadlineExceeded`].
    pub const fn complete(self) -> Result<Self, PublishError> {
        match self {
            Self { missed: 0, .. } => Ok(self),
            Self {
                links,
                missed,
                too_long: 0,
            } => Err(PublishError::DeadlineExceeded { links, missed }),
            Self {
                links,
                missed,
                too_long,
            } => Err(PublishError::TooLong {
                links,
                missed,
                too_long,
            }),
        }
    }

    /// Adds the result of the next message of the same call.
    pub(crate) const fn add(&mut self, next: Self) {
        self.links = next.links;
        self.missed += next.missed;
        self.too_long += next.too_long;
    }
}
