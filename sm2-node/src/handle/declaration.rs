//! The part of a builder that publishers, subscribers, servers and clients share.

use std::sync::Arc;

use sm2_proto::limits::INLINE_MAX;
use sm2_proto::link::MaxLen;
use sm2_proto::{Contract, Kind, Name, TypeId};

use super::Handle;
use crate::driver::{PoolLimit, SharedNode};
use crate::{DeclareError, Message, Wait};

/// Payloads of up to this length are sent inside the datagram, unless a builder changes it.
const INLINE_DEFAULT: usize = 4_096;

/// An interface that a builder will declare.
#[derive(Debug)]
pub(crate) struct Declaration {
    shared: Arc<SharedNode>,
    /// The name as the program wrote it.
    name: String,
    pub(crate) inline_max: usize,
    /// The longest message that the interface accepts.
    pub(crate) max_len: MaxLen,
    pub(crate) wait: Wait,
}

impl Declaration {
    pub(crate) fn new(shared: &Arc<SharedNode>, name: &str) -> Self {
        Self {
            shared: Arc::clone(shared),
            name: name.to_owned(),
            inline_max: INLINE_DEFAULT,
            max_len: MaxLen::DEFAULT,
            wait: Wait::Park,
        }
    }

    /// The name as the program wrote it.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Sets `inline_max`, limited to what fits into a datagram.
    pub(crate) const fn set_inline_max(&mut self, bytes: usize) {
        self.inline_max = if bytes > INLINE_MAX {
            INLINE_MAX
        } else {
            bytes
        };
    }

    /// Checks and returns the name of the topic or service.
    pub(crate) fn checked_name(&self, kind: Kind) -> Result<Name, DeclareError> {
        Name::typed(&self.name).map_err(|reason| DeclareError::Name {
            kind,
            name: self.name.clone(),
            reason,
        })
    }

    /// Declares the interface, and waits for the Manager's answer. `schemas` are its message types.
    pub(crate) fn declare(
        &self,
        contract: Contract,
        pool_limit: PoolLimit,
        schemas: impl IntoIterator<Item = (TypeId, Option<String>)>,
    ) -> Result<Handle, DeclareError> {
        let max_len = self.max_len;
        let mut handle = Handle::declare(&self.shared, contract, pool_limit, max_len, schemas)?;
        handle.inline_max = self.inline_max;
        handle.wait = self.wait;
        Ok(handle)
    }
}

/// Returns a type and its schema text for the Manager. `[u8]` has no text, whatever type it carries.
pub(crate) fn schema_of<T: Message + ?Sized>() -> (TypeId, Option<String>) {
    (T::type_id(), T::schema())
}

/// The setter `sealed` of a builder.
macro_rules! sealed_setter {
    ($qos:ident, $doc:literal) => {
        #[doc = $doc]
        pub const fn sealed(mut self, sealed: bool) -> Self {
            self.$qos.sealed = sealed;
            self
        }
    };
}

/// The setter `inline_max` of a builder, for the messages that its interface sends.
macro_rules! inline_max_setter {
    ($messages:literal) => {
        #[doc = concat!($messages, " of up to this many bytes are copied into the datagram;")]
        /// longer ones, and all on the ring lane, go through shared memory. At most 61,440; 4,096
        /// by default.
        pub const fn inline_max(mut self, bytes: usize) -> Self {
            self.declaration.set_inline_max(bytes);
            self
        }
    };
}

/// The setter `max_len` of a builder, for the messages that its interface receives.
macro_rules! max_len_setter {
    ($message:literal, $beyond:literal) => {
        #[doc = concat!("Sets the longest ", $message, " that is accepted: `bytes`, rounded up to a")]
        /// multiple of 1,024; 1 GiB by default.
        #[doc = $beyond]
        ///
        /// The default is above the longest messages of most robots (images, point clouds and maps of 10
        /// to 500 MB). It bounds the memory and address space that one message of another process takes
        /// here, where the protocol allows 1 TiB.
        pub const fn max_len(mut self, bytes: u64) -> Self {
            self.declaration.max_len = sm2_proto::link::MaxLen::from_bytes(bytes);
            self
        }
    };
}

/// The setter `wait` of a builder, for the messages that its interface receives.
macro_rules! wait_setter {
    ($message:literal) => {
        #[doc = concat!("What a thread does while it waits for ", $message, "; [`Wait::Park`] by")]
        /// default.
        pub const fn wait(mut self, wait: Wait) -> Self {
            self.declaration.wait = wait;
            self
        }
    };
}

pub(crate) use {inline_max_setter, max_len_setter, sealed_setter, wait_setter};
