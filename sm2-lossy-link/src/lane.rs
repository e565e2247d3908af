//! One direction of a link: delays packets, keeps their order, and may lose them. Reads no clock.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use crate::{pauses::Pauses, profile::Profile, random::Random};

/// Bytes of IP and UDP headers.
pub const HEADERS_BYTES: usize = 28;

/// One direction of a link, which carries items of type `T`.
#[derive(Debug)]
pub struct Lane<T> {
    rate_bit: f64,
    delay: Duration,
    jitter: Duration,
    queue: Duration,
    /// The time at which the sender has sent all datagrams at the link's rate.
    free: Instant,
    /// The arrival time of the last item; no later item arrives before it.
    arrived: Instant,
    pauses: Pauses,
    random: Random,
    /// The items in flight, with their arrival times.
    in_flight: VecDeque<(Instant, T)>,
}

impl<T> Lane<T> {
    /// An empty lane. `salt` differs between the two directions: they have the same pauses, counted
    /// from `epoch`, and different jitter and loss.
    #[must_use]
    pub fn new(profile: &Profile, epoch: Instant, salt: u64) -> Self {
        Self {
            rate_bit: profile.rate_bit,
            delay: profile.delay,
            jitter: profile.jitter,
            queue: profile.queue,
            free: epoch,
            arrived: epoch,
            pauses: Pauses::new(&profile.pauses, epoch, profile.seed),
            random: Random::new(profile.seed.wrapping_add(salt << 32)),
            in_flight: VecDeque::new(),
        }
    }

    /// The time at which a datagram of this payload has left its host at the link's rate. `None` if it
    /// is lost, because the queue is full or by random loss.
    pub fn shape(&mut self, now: Instant, len_bytes: usize, loss_permille: u32) -> Option<Instant> {
        let begins = self.free.max(now);
        if begins - now > self.queue {
            return None;
        }
        let bits = 8.0 * (len_bytes + HEADERS_BYTES) as f64;
        self.free = begins + Duration::from_secs_f64(bits / self.rate_bit);
        let is_lost = self.random.below(1_000) < loss_permille.into();
        (!is_lost).then_some(self.free)
    }

    /// Takes an item that has left its host at `sent`.
    pub fn push(&mut self, sent: Instant, item: T) {
        let jitter = self.jitter.mul_f64(self.random.part());
        let due = (sent + self.delay + jitter).max(self.arrived);
        self.arrived = self.pauses.hold(due);
        self.in_flight.push_back((self.arrived, item));
    }

    /// Removes the next item, if it has arrived.
    pub fn pop(&mut self, now: Instant) -> Option<T> {
        match self.due() {
            Some(due) if due <= now => self.in_flight.pop_front().map(|(_, item)| item),
            _ => None,
        }
    }

    /// The arrival time of the next item.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.in_flight.front().map(|(due, _)| *due)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_arrives_in_order_after_delay_and_at_most_jitter() {
        let epoch = Instant::now();
        let profile = Profile {
            pauses: Vec::new(),
            ..Profile::wifi()
        };
        let mut lane = Lane::new(&profile, epoch, 1);
        for number in 0..200_u32 {
            let now = epoch + Duration::from_micros(100) * number;
            lane.push(now, number);
            assert!(lane.arrived >= now + profile.delay);
            assert!(lane.arrived <= now + profile.delay + profile.jitter);
        }
        assert_eq!(lane.pop(epoch + profile.delay / 2), None);
        let end = epoch + Duration::from_secs(1);
        let left: Vec<_> = std::iter::from_fn(|| lane.pop(end)).collect();
        assert_eq!(left, (0..200).collect::<Vec<u32>>());
    }

    /// The numbers of those of `count` datagrams that a link with 4 % loss carries in one direction.
    fn carried(count: u32, salt: u64) -> Vec<u32> {
        let epoch = Instant::now();
        let profile = Profile::wifi();
        let mut lane = Lane::new(&profile, epoch, salt);
        let mut now = epoch;
        for number in 0..count {
            now += Duration::from_micros(100);
            if let Some(sent) = lane.shape(now, 100, profile.loss_permille) {
                lane.push(sent, number);
            }
        }
        let end = now + Duration::from_secs(60);
        std::iter::from_fn(|| lane.pop(end)).collect()
    }

    /// In virtual time, since a socket or the kernel can lose more on a busy machine.
    #[test]
    fn losses_are_as_frequent_as_the_profile_says_and_independent() {
        const COUNT: u32 = 10_000;
        let ways = [1, 2].map(|salt| carried(COUNT, salt));
        for numbers in &ways {
            assert!(numbers.windows(2).all(|it| it[0] < it[1]), "in order, once");
            let lost = COUNT as usize - numbers.len();
            assert!((300..=500).contains(&lost), "{lost}");
            // With independent losses, 4 % of the gaps are longer than one.
            let gaps = numbers.windows(2).filter(|it| it[1] - it[0] > 1).count();
            assert!(
                lost > gaps && 10 * lost < 11 * gaps,
                "{lost} at {gaps} places"
            );
        }
        assert_ne!(ways[0], ways[1], "each direction loses others");
        assert_eq!(carried(COUNT, 1), ways[0], "the same in each run");
    }
}
