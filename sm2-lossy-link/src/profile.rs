//! The properties of a link, and its two sides.

use std::time::Duration;

use crate::pauses::Pause;

/// How a link is, each way.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// What it carries, in bits per second, with all headers.
    pub rate_bit: f64,
    /// How many datagrams of a thousand it loses, each by chance.
    pub loss_permille: u32,
    /// How long a datagram takes at least.
    pub delay: Duration,
    /// How much longer at most.
    pub jitter: Duration,
    /// How long a datagram may wait for those before it: later ones are lost.
    pub queue: Duration,
    /// When it stands still.
    pub pauses: Vec<Pause>,
    /// The same seed makes the same jitter and pauses, and in a relay the same losses, as far as
    /// the traffic is the same.
    pub seed: u64,
}

impl Profile {
    /// The Wi-Fi of the paper that SM2 goes back to (section IV-A): 30.8 Mbit/s, 4 % lost, below 15 ms to and
    /// fro, with spikes of 102 ms and of 1,030 ms. How often those came is not said there: here the short one
    /// comes about every 5 s, the long one about every 30 s.
    #[must_use]
    pub fn wifi() -> Self {
        let pause = |length, every| Pause {
            length: Duration::from_millis(length),
            every: Duration::from_secs(every),
        };
        Self {
            rate_bit: 30.8e6,
            loss_permille: 40,
            delay: Duration::from_micros(7_500),
            jitter: Duration::from_millis(1),
            queue: Duration::from_millis(60),
            pauses: vec![pause(102, 5), pause(1_030, 30)],
            seed: 1,
        }
    }
}

/// One of the two hosts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The one that connects.
    Near,
    /// The one that it connects to.
    Far,
}
