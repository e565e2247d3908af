use super::*;

const MTU: u16 = 1_200;
/// A fraction that binary numbers have exactly.
const RTT: Duration = Duration::from_millis(125);

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// A controller whose reports the test makes.
struct Link {
    steady: Steady,
    now: Instant,
}

impl Link {
    fn new() -> Self {
        let now = Instant::now();
        let steady = Steady::new(now, MTU);
        Self { steady, now }
    }

    /// A round that reports so many bytes as delivered, and so many as lost.
    fn round(&mut self, acked: u64, lost: u64) -> u64 {
        self.round_of(acked, lost, false)
    }

    fn round_of(&mut self, acked: u64, lost: u64, app_limited: bool) -> u64 {
        self.now += RTT;
        let sent = self.now - RTT;
        // The datagrams of a round are acknowledged one by one.
        self.steady.add_ack(self.now, sent, 0, app_limited);
        self.steady.add_ack(self.now, sent, acked, false);
        if lost > 0 {
            self.steady
                .on_congestion_event(self.now, self.now, false, lost);
        }
        self.steady.on_end_acks(self.now, 0, app_limited, None);
        self.steady.window()
    }

    /// A link in its drain phase that delivers a million bytes in a round trip: eight in a second.
    fn drained() -> Self {
        let mut link = Self::new();
        for _ in 0..4 {
            link.round(1_000_000, 0);
        }
        assert_eq!(link.steady.phase, Phase::Drain);
        link
    }
}

/// The window for the rate of [`Link::drained`] and a queue, if so much is lost at random.
fn assert_window(window: u64, queue: Duration, random_loss: f64) {
    let expected = 8e6 * (RTT + queue).as_secs_f64() / (1.0 - random_loss);
    assert!(
        (window as f64 - expected).abs() <= 1.0,
        "{window} {expected}"
    );
}

#[test]
fn the_start_doubles_its_window_until_three_rounds_were_no_faster() {
    let mut link = Link::new();
    let first = 10 * u64::from(MTU);
    assert_eq!(
        (link.steady.window(), link.steady.initial_window()),
        (first, first)
    );
    assert_eq!(link.round(100_000, 0), 2 * first);
    // A quarter faster is not enough.
    assert_eq!(link.round(125_000, 0), 2 * first);
    assert_eq!(link.round(126_000, 0), 4 * first);
    assert_eq!(link.round(1_000_000, 0), 8 * first);
    assert_eq!(link.round(1_000_000, 0), 8 * first);
    assert_eq!(link.round(1_100_000, 0), 8 * first);
    // The third round that was no faster: the fastest one counts.
    assert_eq!(link.round(1_000_000, 0), 1_100_000 / 4 * 3);
    assert_eq!(link.steady.phase, Phase::Drain);
}

#[test]
fn the_start_ends_if_more_than_half_was_lost() {
    let mut link = Link::new();
    link.round(1_000_000, 0);
    link.round(1_000_000, 1_000_000);
    assert_eq!(
        link.steady.phase,
        Phase::Start {
            best: 8_000_000,
            slow: 1
        }
    );
    assert_eq!(link.round(1_000_000, 1_000_001), 750_000);
}

#[test]
fn rounds_of_an_idle_application_prove_nothing_about_the_link() {
    let mut link = Link::new();
    let first = link.steady.window();
    for _ in 0..10 {
        link.round_of(1_000, 0, true);
        assert_eq!(link.steady.window(), first);
    }
    let mut link = Link::drained();
    let rate = link.steady.rate();
    // Not even many of them make the link slower. A faster one shows that it is faster.
    for _ in 0..2 * RATE_ROUNDS {
        link.round_of(1_000, 0, true);
        assert_eq!(link.steady.rate(), rate);
    }
    link.round_of(2_000_000, 0, true);
    assert_eq!(link.steady.rate(), 2 * rate);
}

/// The table of the module.
#[test]
fn the_phases_follow_each_other() {
    let mut link = Link::drained();
    for _ in 0..3 {
        // The window of the drain phase leaves the queue empty.
        assert_eq!(link.steady.window(), 750_000);
        for left in (0..=CRUISE_ROUNDS).rev() {
            let window = link.round(1_000_000, 0);
            assert_eq!(link.steady.phase, Phase::Cruise { left });
            assert_window(window, QUEUE, 0.0);
        }
        let window = link.round(1_000_000, 0);
        assert_eq!(link.steady.phase, Phase::Probe);
        assert_window(window * 4 / 5, QUEUE, 0.0);
        link.round(1_000_000, 0);
        assert_eq!(link.steady.phase, Phase::Drain);
    }
}

#[test]
fn the_window_grows_by_the_share_that_is_lost_at_random() {
    let mut link = Link::drained();
    // The first report of a cruise is on the data of the drain phase. The loss before it says nothing.
    let window = link.round(1_000_000, 400_000);
    assert_window(window, QUEUE, 0.0);
    // A fifth of all is lost, and then half, which counts by a quarter.
    for (lost, share) in [(250_000, 0.2), (1_000_000, 0.275), (9_000_000, 0.33125)] {
        let window = link.round(1_000_000, lost);
        assert!(
            (link.steady.random_loss.unwrap() - share).abs() < 1e-9,
            "{share}"
        );
        assert_window(window, QUEUE, share);
        // The other rounds of the cruise change nothing.
        while link.steady.phase != Phase::Drain {
            link.round(1_000_000, 0);
        }
        link.round(1_000_000, 0);
        assert_eq!(
            link.steady.phase,
            Phase::Cruise {
                left: CRUISE_ROUNDS
            }
        );
    }
}

#[test]
fn a_rate_is_the_fastest_of_twelve_rounds_or_of_two_in_congestion() {
    let mut link = Link::drained();
    link.round(1_000_000, 0);
    link.round(1_000_000, 0);
    for _ in 1..RATE_ROUNDS {
        link.round(500_000, 0);
        assert_eq!(link.steady.rate(), 8_000_000);
    }
    link.round(500_000, 0);
    assert_eq!(link.steady.rate(), 4_000_000);

    let mut link = Link::drained();
    link.round(1_000_000, 0);
    link.round(1_000_000, 0);
    // A fifth more than the random loss of 0 is not congestion yet.
    link.round(400_000, 100_000);
    link.round(400_000, 100_000);
    assert_eq!(link.steady.rate(), 8_000_000);
    link.round(400_000, 110_000);
    assert_eq!(link.steady.rate(), 3_200_000);
}

#[test]
fn the_minimum_round_trip_is_that_of_the_last_ten_seconds() {
    let begin = Instant::now();
    let mut steady = Steady::new(begin, MTU);
    assert_eq!(steady.min_rtt(), ROUND_MIN, "before the first sample");
    let mut sample = |at, rtt| {
        steady.add_rtt_sample(begin + ms(at), ms(rtt));
        steady.min_rtt()
    };
    assert_eq!(sample(0, 70), ms(70));
    assert_eq!(sample(1_000, 50), ms(50));
    assert_eq!(sample(4_999, 100), ms(50));
    // The second half of the ten seconds, and the next half, which takes the place of the first one.
    assert_eq!(sample(5_000, 100), ms(50));
    assert_eq!(sample(9_999, 90), ms(50));
    assert_eq!(sample(10_000, 100), ms(90));
    assert_eq!(sample(15_000, 100), ms(100));
}

#[test]
fn a_round_is_a_round_trip_and_ten_milliseconds_at_least() {
    for (rtt, length) in [(1, 10), (10, 10), (40, 40)] {
        let begin = Instant::now();
        let mut steady = Steady::new(begin, MTU);
        let first = steady.window();
        steady.add_rtt_sample(begin, ms(rtt));
        steady.round.acked = 100_000;
        steady.on_end_acks(begin + ms(length - 1), 0, false, None);
        assert_eq!(steady.window(), first, "{rtt} ms");
        steady.on_end_acks(begin + ms(length), 0, false, None);
        assert_eq!(steady.window(), 2 * first, "{rtt} ms");
    }
}

#[test]
fn the_window_has_eight_datagrams_at_least() {
    let mut link = Link::new();
    for _ in 0..10 {
        link.round(1, 0);
    }
    assert_eq!(link.steady.window(), 8 * u64::from(MTU));
    link.steady.on_mtu_update(1_400);
    assert_eq!(link.steady.window(), 8 * 1_400);
    // A smaller datagram does not shrink the window.
    link.steady.on_mtu_update(1_300);
    assert_eq!(link.steady.window(), 8 * 1_400);
}

/// A path that brought nothing for long may be another one now.
#[test]
fn persistent_congestion_begins_anew() {
    let mut link = Link::drained();
    link.steady.on_mtu_update(1_400);
    let now = link.now;
    link.steady.on_congestion_event(now, now, true, 1);
    assert_eq!(link.steady.window(), 14_000);
    assert_eq!(link.steady.phase, Phase::Start { best: 0, slow: 0 });
    assert_eq!((link.steady.rate(), link.steady.min_rtt()), (0, ROUND_MIN));
}

#[test]
fn a_copy_has_the_same_state() {
    let link = Link::drained();
    let copy = link.steady.clone_box();
    assert_eq!(copy.window(), 750_000);
    assert!(copy.into_any().is::<Steady>());
    let built = Arc::new(SteadyConfig).build(link.now, 1_400);
    assert_eq!((built.window(), built.initial_window()), (14_000, 14_000));
}
