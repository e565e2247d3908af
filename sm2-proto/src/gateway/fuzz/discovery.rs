//! Discovery under datagrams that anybody can send.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    vec::Vec,
};
use core::{
    net::{Ipv6Addr, SocketAddr},
    time::Duration,
};

use super::super::{
    Beacon, GatewayId,
    discovery::{Discovery, Input, Output},
};
use crate::{Instant, Machine, fuzz::script::Script};

const ME: GatewayId = GatewayId([9; 32]);
const LONGEST: Duration = Duration::from_secs(5);

/// A gateway dials only peers that it trusts, only at addresses of the configuration or of the two
/// newest beacons, one attempt at a time, at growing intervals, and it never gives a peer up.
//= SM2-GWD-001, SM2-GWD-002, SM2-GWD-003, SM2-GWD-004, SM2-GWD-005 fuzz
pub(crate) fn discovery(data: &[u8]) {
    let mut script = Script::new(data);
    let Some(flags) = script.byte() else {
        return;
    };
    let announces = flags & 1 != 0;
    let now = Instant(1);
    let mut world = World {
        discovery: Discovery::new(now, ME, flags.into(), announces),
        now,
        peers: BTreeMap::new(),
        looked: (now, 0),
        announces,
        announced: None,
    };
    while world.step(&mut script).is_some() {}
    world.check_all_dialled();
}

/// The oracle of one trusted peer.
#[derive(Default)]
struct Peer {
    configured: Vec<SocketAddr>,
    /// The addresses of beacons, the newest first, at most two.
    heard: Vec<SocketAddr>,
    dialling: bool,
    /// The epoch and the beginning of the connection, if there is one.
    connected: Option<(u64, Instant)>,
    /// Whether a beacon named a greater epoch since the connection or the latest attempt beside it began.
    hinted: bool,
    /// The time of the latest attempt, and the number of attempts since the backoff was reset.
    dialled: Option<(Instant, u32)>,
}

struct World {
    discovery: Discovery,
    now: Instant,
    peers: BTreeMap<GatewayId, Peer>,
    /// The beginning of the current second of datagrams, and their number.
    looked: (Instant, u32),
    announces: bool,
    announced: Option<Instant>,
}

impl World {
    fn step(&mut self, script: &mut Script<'_>) -> Option<()> {
        let choice = script.byte()?;
        let peer = match choice >> 4 & 3 {
            3 => ME,
            it => GatewayId([it; 32]),
        };
        match choice % 16 {
            0 | 1 => self.trust(peer, script.byte()?),
            2 if script.rarely()? => {
                self.peers.remove(&peer);
                self.feed(Input::Distrust { peer });
            }
            2 | 3 => {
                let epoch = script.number()?;
                if let Some(it) = self.peers.get_mut(&peer) {
                    (it.dialling, it.hinted) = (false, false);
                    it.connected = Some((epoch, self.now));
                }
                self.feed(Input::Connected { peer, epoch });
            }
            4 => self.lost(peer),
            5 | 6 => {
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.dialling = false;
                }
                self.feed(Input::Failed { peer });
            }
            7 => {
                let from = address(script.byte()?);
                let bytes = script.bytes()?.to_vec();
                self.datagram(from, &bytes);
            }
            8..=10 => self.beacon(peer, script)?,
            11 => {
                // A flood of datagrams.
                let (from, count) = (address(script.byte()?), 4 * u16::from(script.byte()?));
                for _ in 0..count {
                    self.datagram(from, b"SM2G");
                }
            }
            12 | 13 => {
                let deadline = self.discovery.deadline();
                self.now = deadline.map_or(self.now, |it| it.max(self.now));
                self.feed(Input::Tick);
            }
            _ => {
                let ms = 1 << (script.byte()? % 13);
                self.now = self.now.after(Duration::from_millis(ms));
                self.feed(Input::Tick);
            }
        }
        Some(())
    }

    fn trust(&mut self, peer: GatewayId, choice: u8) {
        let addresses: Vec<SocketAddr> = (0..choice % 3).map(address).collect();
        let it = self.peers.entry(peer).or_default();
        it.configured.clone_from(&addresses);
        self.feed(Input::Trust {
            peer,
            addresses,
            hosts: 0,
        });
    }

    fn lost(&mut self, peer: GatewayId) {
        if let Some(it) = self.peers.get_mut(&peer)
            && let Some((_, since)) = it.connected.take()
        {
            it.hinted = false;
            if self.now.since(since) >= LONGEST {
                it.dialled = None;
            }
        }
        self.feed(Input::Lost { peer });
    }

    fn beacon(&mut self, gateway: GatewayId, script: &mut Script<'_>) -> Option<()> {
        let beacon = Beacon {
            port: script.number()? as u16,
            gateway,
            epoch: script.number()?,
        };
        let mut bytes = beacon.to_bytes();
        if script.rarely()? {
            let at = usize::from(script.byte()?) % bytes.len();
            bytes[at] = script.byte()?;
        }
        self.datagram(address(script.byte()?), &bytes);
        Some(())
    }

    /// Feeds a datagram of the multicast group.
    fn datagram(&mut self, from: SocketAddr, bytes: &[u8]) {
        if self.now.since(self.looked.0) >= Duration::from_secs(1) {
            self.looked = (self.now, 0);
        }
        self.looked.1 += 1;
        if self.looked.1 <= 256
            && let Ok(beacon) = Beacon::from_bytes(bytes)
            && beacon.gateway != ME
            && let Some(peer) = self.peers.get_mut(&beacon.gateway)
        {
            let mut address = from;
            address.set_port(beacon.port);
            if peer.heard.first() != Some(&address) {
                peer.heard.insert(0, address);
                peer.heard.truncate(2);
            }
            peer.hinted |= peer
                .connected
                .is_some_and(|(epoch, _)| epoch < beacon.epoch);
        }
        self.feed(Input::Beacon { from, bytes });
    }

    fn feed(&mut self, input: Input<'_>) {
        let Ok(()) = self.discovery.handle(self.now, input);
        while let Some(output) = self.discovery.poll() {
            match output {
                Output::Dial { peer, address } => self.dialled(peer, address),
                Output::DialHost { .. } => unreachable!("no host has a name here"),
                Output::Announce => {
                    let last = self.announced.replace(self.now);
                    let least = Duration::from_millis(500);
                    assert!(self.announces);
                    assert!(last.is_none_or(|it| self.now.since(it) >= least));
                }
            }
        }
        self.check();
    }

    fn dialled(&mut self, id: GatewayId, address: SocketAddr) {
        let peer = self.peers.get_mut(&id).expect("only whom it trusts");
        let mut named = peer.configured.iter().chain(&peer.heard);
        assert!(named.any(|it| *it == address), "{id} at {address}");
        assert!(!peer.dialling, "{id}: one attempt at a time");
        assert!(peer.connected.is_none() || peer.hinted, "{id}: for what");
        peer.hinted = false;
        peer.dialling = true;
        let (last, count) = peer
            .dialled
            .map_or((None, 0), |(at, count)| (Some(at), count));
        if let Some(last) = last {
            // A wait is at least half of the longest one, which doubles with each attempt.
            let longest = Duration::from_millis(10 << count.min(9)).min(LONGEST);
            let waited = self.now.since(last);
            assert!(waited >= longest / 2, "{id}: {waited:?} after {count}");
        }
        peer.dialled = Some((self.now, count + 1));
    }

    /// Each peer with an address is dialled within the longest wait.
    fn check(&self) {
        let deadline = self.discovery.deadline();
        let in_time = |at: Instant| self.now < at && at <= self.now.after(LONGEST);
        let waits = |it: &Peer| {
            let is_somewhere = !it.configured.is_empty() || !it.heard.is_empty();
            is_somewhere && !it.dialling && it.connected.is_none()
        };
        let someone_waits = self.announces || self.peers.values().any(waits);
        assert!(
            !someone_waits || deadline.is_some_and(in_time),
            "{deadline:?}"
        );
    }

    /// After the last operation, each peer with an address is dialled or connected.
    fn check_all_dialled(&mut self) {
        let idle: BTreeSet<GatewayId> = self.peers.keys().copied().collect();
        for _ in 0..8 {
            self.now = self.now.after(LONGEST);
            self.feed(Input::Tick);
        }
        for peer in idle {
            let it = &self.peers[&peer];
            let is_somewhere = !it.configured.is_empty() || !it.heard.is_empty();
            assert!(
                it.dialling || it.connected.is_some() || !is_somewhere,
                "{peer}"
            );
        }
    }
}

/// The address of one of four hosts.
fn address(choice: u8) -> SocketAddr {
    let host = Ipv6Addr::new(0xfe80, 0, 0, 0, 0, 0, 0, u16::from(choice % 4));
    SocketAddr::from((host, 7_632))
}
