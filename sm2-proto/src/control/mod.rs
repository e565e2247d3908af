//! Control frames between a node and its Manager (SPEC section 3).

mod codec;
mod frames;
mod items;
mod limits;
#[cfg(any(kani, test))]
mod proofs;
mod stated_limits;

pub(crate) use codec::{DecodeError, decode, encode};
pub use codec::{decode_to_manager, decode_to_node, encode_to_manager, encode_to_node};
pub use frames::{
    Changes, LinkPeer, Page, PolicyProblem, ReloadOutcome, SchemaText, ToManager, ToNode,
};
pub use items::{Change, Item, Key, UnlinkedReason};
pub use limits::{Limit, LimitError, Limits, Shown, Unit};
pub use stated_limits::{StatedLimit, StatedLimits};
