//! The properties of a link, and its two sides.

use std::time::Duration;

use crate::pauses::Pause;

/// The properties of each direction of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The rate in bits per second, including all headers.
    pub rate_bit: f64,
    /// The random loss, in datagrams per thousand.
    pub loss_permille: u32,
    /// The least delay of a datagram.
    pub delay: Duration,
    /// The largest random addition to the delay.
    pub jitter: Duration,
    /// The longest time that a datagram may wait in the queue; datagrams that would wait longer are
    /// lost.
    pub queue: Duration,
    /// The pauses of the link.
    pub pauses: Vec<Pause>,
    /// The seed of jitter and pauses, and of the losses of a relay. With the same traffic, the same
    /// seed gives the same results.
    pub seed: u64,
}

impl Profile {
    /// The Wi-Fi link of the paper that SM2 is based on (section IV-A): 30.8 Mbit/s, 4 % loss, a round
    /// trip below 15 ms, and spikes of 102 ms and 1,030 ms. The paper does not say how often the
    /// spikes came; here the short pause comes about every 5 s, and the long one about every 30 s.
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

/// One of the two hosts of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The host that connects.
    Near,
    /// The host that is connected to.
    Far,
}
