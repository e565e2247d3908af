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
    /// The time when the sender has sent all datagrams at the link's rate.
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

    /// The time when a datagram of this payload has left its host at the link's rate. `None` if it
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

    /// A lane whose host sends a byte in a millisecond, without jitter and pauses.
    fn slow_lane(epoch: Instant) -> Lane<u32> {
        let profile = Profile {
            rate_bit: 8_000.0,
            delay: ms(7),
            jitter: Duration::ZERO,
            queue: ms(300),
            pauses: Vec::new(),
            ..Profile::wifi()
        };
        Lane::new(&profile, epoch, 1)
    }

    const fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    /// A datagram of 100 bytes with its headers takes 100 ms.
    #[test]
    fn datagrams_leave_at_the_rate_and_those_that_would_wait_longer_than_the_queue_are_lost() {
        let epoch = Instant::now();
        let mut lane = slow_lane(epoch);
        let mut shape = |millis| {
            let sent = lane.shape(epoch + ms(millis), 100 - HEADERS_BYTES, 0);
            sent.map(|it| it - epoch)
        };
        // The fourth one waits exactly as long as the queue holds.
        for expected in [100, 200, 300, 400] {
            assert_eq!(shape(0), Some(ms(expected)));
        }
        assert_eq!(shape(0), None);
        assert_eq!(shape(99), None);
        // A datagram that found no room takes no time of the link.
        assert_eq!(shape(100), Some(ms(500)));
        // The link was idle.
        assert_eq!(shape(1_000), Some(ms(1_100)));
        assert_eq!(shape(1_050), Some(ms(1_200)));
    }

    #[test]
    fn datagrams_are_lost_as_the_loss_says_at_its_ends_too() {
        let epoch = Instant::now();
        let mut lane = slow_lane(epoch);
        for number in 0..10_000_u32 {
            let now = epoch + ms(1_000) * number;
            assert_eq!(lane.shape(now, 100 - HEADERS_BYTES, 1_000), None);
            // A datagram that is lost on its way was sent all the same.
            let sent = lane.shape(now, 100 - HEADERS_BYTES, 0);
            assert_eq!(sent, Some(now + ms(200)), "{number}");
        }
    }

    #[test]
    fn an_item_is_there_from_the_time_at_which_it_is_due() {
        let epoch = Instant::now();
        let mut lane = slow_lane(epoch);
        assert_eq!((lane.due(), lane.pop(epoch)), (None, None));
        lane.push(epoch + ms(10), 1);
        lane.push(epoch + ms(20), 2);
        let due = epoch + ms(17);
        assert_eq!(lane.due(), Some(due));
        assert_eq!(lane.pop(due - Duration::from_nanos(1)), None);
        assert_eq!(lane.pop(due), Some(1));
        assert_eq!(lane.pop(due), None);
        assert_eq!(lane.due(), Some(epoch + ms(27)));
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
