//! The messages of a bridge: those of topics, requests and replies.

use std::fmt;

/// Messages since the start: those of topics, requests and replies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// From the domain to the network; messages of durable topics each time that they are sent.
    pub sent: u64,
    /// From the network to the domain.
    pub received: u64,
    /// Newer messages displaced them before the bridge took them from the domain.
    pub lost: u64,
    /// Zenoh or the Manager refuses them, or they are damaged.
    pub refused: u64,
    /// The rules deny them.
    pub denied: u64,
    /// They come from a bridge of the same domain.
    pub returned: u64,
    /// Messages of durable topics that came again. They are acknowledged, and not published again.
    pub duplicates: u64,
    /// They came from the network while too many others waited.
    pub dropped: u64,
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            sent,
            received,
            lost,
            refused,
            denied,
            returned,
            duplicates,
            dropped,
        } = self;
        write!(
            f,
            "{sent} sent, {received} received, {lost} lost, {refused} refused, {denied} denied, {returned} returned, \
             {duplicates} duplicates, {dropped} dropped"
        )
    }
}
