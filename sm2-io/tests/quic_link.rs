//! The throughput of a connection over a lossy link, in virtual time.

use std::{
    cmp::Reverse,
    collections::BinaryHeap,
    net::SocketAddr,
    time::{Duration, Instant},
};

use quinn_proto::{Connection, ConnectionHandle, Dir, Event, StreamId};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};

/// The properties of a simulated link.
#[derive(Clone, Copy)]
struct Link {
    rate_bit: f64,
    loss_permille: u64,
    delay: Duration,
    /// The queue's length. Datagrams that would wait longer are lost.
    queue: Duration,
}

const PAPER: Link = Link {
    rate_bit: 30.8e6,
    loss_permille: 40,
    delay: Duration::from_micros(7_500),
    queue: Duration::from_millis(60),
};

/// One side: an endpoint and its connection.
struct Side {
    endpoint: Endpoint,
    connection: Option<(ConnectionHandle, Connection)>,
    address: SocketAddr,
    /// The time when the outgoing link has sent everything that it was given.
    free: Instant,
}

/// The results of a run.
#[derive(Debug)]
struct Figures {
    /// The payload as a share of the link's rate.
    share: f64,
    rtt: Duration,
    /// The share of datagrams that were lost at random or at a full queue.
    lost: f64,
}

/// A datagram in flight: its arrival time, its number, the receiving side, its bytes.
type Flying = Reverse<(Instant, u64, usize, Vec<u8>)>;

struct World {
    link: Link,
    sides: [Side; 2],
    flying: BinaryHeap<Flying>,
    count: u64,
    random: u64,
}

impl World {
    fn new(link: Link, congestion: Congestion, start: Instant) -> Self {
        let keys = [(); 2].map(|()| SecretKey::generate().unwrap());
        let trusted = Trusted::default();
        trusted.set(keys.iter().map(SecretKey::id));
        let far = keys[1].id();
        let mut port = 0;
        let sides = keys.map(|key| {
            port += 1;
            Side {
                endpoint: Endpoint::new(key, trusted.clone(), congestion, Some([port; 32]))
                    .unwrap(),
                connection: None,
                address: SocketAddr::from(([10, 0, 0, port], 7_633)),
                free: start,
            }
        });
        let mut world = Self {
            link,
            sides,
            flying: BinaryHeap::new(),
            count: 0,
            random: 0x1234_5678_9abc_def1,
        };
        let address = world.sides[1].address;
        let connection = world.sides[0].endpoint.connect(start, far, address);
        world.sides[0].connection = Some(connection.unwrap());
        world
    }

    fn random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }

    fn carry(&mut self, now: Instant, from: usize, bytes: &[u8]) {
        let begins = self.sides[from].free.max(now);
        if begins - now > self.link.queue {
            return;
        }
        let bits = 8.0 * (bytes.len() + 28) as f64;
        let sent = begins + Duration::from_secs_f64(bits / self.link.rate_bit);
        self.sides[from].free = sent;
        if self.random() % 1_000 >= self.link.loss_permille {
            self.count += 1;
            let due = sent + self.link.delay;
            self.flying
                .push(Reverse((due, self.count, 1 - from, bytes.to_vec())));
        }
    }

    fn transmit(&mut self, now: Instant, at: usize) {
        let mut buffer = Vec::new();
        loop {
            buffer.clear();
            let side = &mut self.sides[at];
            let Some((handle, connection)) = &mut side.connection else {
                return;
            };
            while let Some(event) = connection.poll_endpoint_events() {
                if let Some(answer) = side.endpoint.event(*handle, event) {
                    connection.handle_event(answer);
                }
            }
            let Some(transmit) = connection.poll_transmit(now, 1, &mut buffer) else {
                return;
            };
            let bytes = buffer[..transmit.size].to_vec();
            self.carry(now, at, &bytes);
        }
    }

    fn deliver(&mut self, now: Instant, to: usize, bytes: &[u8]) {
        let from = self.sides[1 - to].address;
        let side = &mut self.sides[to];
        let mut answer = Vec::new();
        match side.endpoint.handle(now, from, None, bytes, &mut answer) {
            Some(Arrival::New(handle, connection)) => side.connection = Some((handle, *connection)),
            Some(Arrival::Event(_, event)) => {
                if let Some((_, connection)) = &mut side.connection {
                    connection.handle_event(event);
                }
            }
            Some(Arrival::Answer(_)) | None => {}
        }
    }

    /// Advances the time to the next event, and returns that time.
    fn step(&mut self, now: Instant) -> Instant {
        let timers = self.sides.iter_mut().filter_map(|side| {
            let (_, connection) = side.connection.as_mut()?;
            connection.poll_timeout()
        });
        let timer = timers.min();
        let arrival = self.flying.peek().map(|Reverse((due, ..))| *due);
        let next = [timer, arrival].into_iter().flatten().min();
        let now = next.map_or(now + Duration::from_secs(1), |it| it.max(now));
        while let Some(Reverse((due, ..))) = self.flying.peek()
            && *due <= now
        {
            let Reverse((_, _, to, bytes)) = self.flying.pop().unwrap();
            self.deliver(now, to, &bytes);
        }
        for side in &mut self.sides {
            if let Some((_, connection)) = &mut side.connection {
                connection.handle_timeout(now);
            }
        }
        now
    }
}

/// The seconds of a run. In the first two the connection finds its rate.
const SECONDS: u64 = if cfg!(feature = "slow") { 12 } else { 4 };

/// Sends as much as possible for `length`.
fn run(link: Link, congestion: Congestion, length: Duration) -> Figures {
    let start = Instant::now();
    let mut world = World::new(link, congestion, start);
    let (mut now, mut received, mut stream) = (start, 0_u64, None::<StreamId>);
    let warm = start + Duration::from_secs(2);
    let data = vec![7; 1 << 16];
    let (mut rtt, mut lost) = (Duration::ZERO, 0.0);
    while now < start + length {
        for at in 0..2 {
            if let Some((_, connection)) = &mut world.sides[at].connection {
                while let Some(event) = connection.poll() {
                    if matches!(event, Event::Connected) && at == 0 {
                        stream = connection.streams().open(Dir::Uni);
                    }
                }
                if at == 1 {
                    connection.streams().accept(Dir::Uni);
                    if let Ok(mut chunks) = connection
                        .recv_stream(StreamId::new(quinn_proto::Side::Client, Dir::Uni, 0))
                        .read(true)
                    {
                        while let Ok(Some(chunk)) = chunks.next(usize::MAX) {
                            if now >= warm {
                                received += chunk.bytes.len() as u64;
                            }
                        }
                        let _ = chunks.finalize();
                    }
                }
                if let (0, Some(id)) = (at, stream) {
                    let window = connection.congestion_state().window();
                    connection.set_send_window(8 * window + 20_000);
                    while connection.send_stream(id).write(&data).is_ok() {}
                    rtt = connection.rtt();
                    let path = connection.stats().path;
                    lost = path.lost_packets as f64 / path.sent_packets.max(1) as f64;
                }
            }
            world.transmit(now, at);
        }
        now = world.step(now);
    }
    let seconds = (length - Duration::from_secs(2)).as_secs_f64();
    let carried = link.rate_bit / 8.0 * (1.0 - link.loss_permille as f64 / 1e3);
    // The share of payload in a datagram of 1,452 bytes with its headers.
    let payload = 0.95;
    Figures {
        share: received as f64 / seconds / (carried * payload),
        rtt,
        lost,
    }
}

/// The link of the paper. Figures of the other controllers are only printed.
#[test]
fn loss_by_chance_does_not_slow_a_connection_down() {
    let length = Duration::from_secs(if cfg!(feature = "slow") { 22 } else { 4 });
    for congestion in [Congestion::Bbr, Congestion::Cubic, Congestion::NewReno] {
        if cfg!(feature = "slow") {
            println!("{congestion:?}: {:?}", run(PAPER, congestion, length));
        }
    }
    let steady = run(PAPER, Congestion::Steady, length);
    println!("Steady: {steady:?}");
    assert!(steady.share > 0.9, "{steady:?}");
    assert!(steady.rtt < Duration::from_millis(40), "{steady:?}");
}

/// Other links, each described by its difference from the paper's link, and the least share of the rate that
/// must be used.
#[test]
fn other_links_are_used_as_well() {
    let ms = Duration::from_millis;
    let clean = Link {
        loss_permille: 0,
        ..PAPER
    };
    let lossy = |loss_permille| Link {
        loss_permille,
        ..PAPER
    };
    let distant = |loss_permille| Link {
        delay: ms(50),
        ..lossy(loss_permille)
    };
    let queue = ms(3);
    let rate = |rate_bit| Link { rate_bit, ..clean };
    let links = [
        ("nothing lost", 0.95, clean),
        ("30 % lost", 0.9, lossy(300)),
        ("100 ms of round-trip time", 0.9, distant(40)),
        ("100 ms, 20 % lost", 0.9, distant(200)),
        ("a short queue", 0.9, Link { queue, ..clean }),
        ("1 Mbit/s", 0.9, rate(1e6)),
        ("200 Mbit/s", 0.9, rate(200e6)),
    ];
    // The quick form leaves out the fastest link, which carries most datagrams, and the links that need long to find
    // their rate.
    let quick = ["nothing lost", "30 % lost", "1 Mbit/s"];
    let links = links.into_iter();
    for (name, least, link) in links.filter(|it| cfg!(feature = "slow") || quick.contains(&it.0)) {
        let steady = run(link, Congestion::Steady, Duration::from_secs(SECONDS));
        println!("{name}: {steady:?}");
        assert!(steady.share > least, "{name}");
        // Datagrams that the full queue dropped, in addition to random loss.
        let chance = link.loss_permille as f64 / 1e3;
        assert!(steady.lost < chance + 0.3, "{name}");
    }
}

/// A connection without data for a minute; then the link is cut.
//= SM2-GWC-003 test
#[test]
fn a_connection_lives_as_long_as_something_comes() {
    let start = Instant::now();
    let quiet = Link {
        loss_permille: 0,
        ..PAPER
    };
    let mut world = World::new(quiet, Congestion::Steady, start);
    let cut = start + Duration::from_secs(60);
    let (mut now, mut lost) = (start, [None; 2]);
    while lost.contains(&None) {
        assert!(now < cut + Duration::from_secs(60), "it never ends");
        if now >= cut {
            world.link.loss_permille = 1_000;
        }
        for (at, lost) in lost.iter_mut().enumerate() {
            if let Some((_, connection)) = &mut world.sides[at].connection {
                while let Some(event) = connection.poll() {
                    if matches!(event, Event::ConnectionLost { .. }) {
                        *lost = Some(now);
                    }
                }
            }
            world.transmit(now, at);
        }
        now = world.step(now);
    }
    for lost in lost.into_iter().flatten() {
        assert!(lost >= cut + Duration::from_secs(3), "{:?}", lost - start);
        assert!(lost <= cut + Duration::from_secs(7), "{:?}", lost - start);
    }
}
