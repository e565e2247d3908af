//! What became of one publication.

use crate::PublishError;

/// What became of one publication.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// How many links took it.
    pub links: usize,
    /// How many reliable links had no room for it until the deadline. They go
    /// without this message, and are not waited for again until they give something back
    /// (SM2-QOS-002).
    pub missed: usize,
}

impl Published {
    /// That no reliable subscriber missed the message.
    ///
    /// # Errors
    ///
    /// [`PublishError::DeadlineExceeded`] if one did.
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
