//! The result of one publication.

use crate::PublishError;

/// The result of one publication.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// How many links accepted the message.
    pub links: usize,
    /// How many reliable links had no room until the deadline, or hold too much of the pool. They miss this
    /// message, and are not waited for again until they release a message (SM2-QOS-002, SM2-QOS-006).
    pub missed: usize,
}

impl Published {
    /// Returns an error if a reliable subscriber missed the message.
    ///
    /// # Errors
    ///
    /// [`PublishError::DeadlineExceeded`].
    pub const fn complete(self) -> Result<Self, PublishError> {
        match self {
            Self { missed: 0, .. } => Ok(self),
            Self { links, missed } => Err(PublishError::DeadlineExceeded { links, missed }),
        }
    }

    /// Adds the result of the next message of the same call.
    pub(crate) const fn add(&mut self, next: Self) {
        self.links = next.links;
        self.missed += next.missed;
    }
}
