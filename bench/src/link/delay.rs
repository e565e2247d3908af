//! The delay of a link: reads IP packets from a TUN device, holds them, and writes them back in order.

use std::{
    io,
    os::fd::AsFd,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use nix::{
    poll::{PollFd, PollFlags, ppoll},
    sys::time::TimeSpec,
};
use sm2_lossy_link::{Lane, Profile};
use tun_rs::{DeviceBuilder, SyncDevice};

use super::address::address;
use crate::job::Side;

/// The payload of one Ethernet frame, in bytes.
const MTU: u16 = 1_500;

/// The number of packets that the kernel queues while the thread waits for a processor.
const KERNEL_PACKETS: u32 = 4_000;

/// The most packets that are read before due packets are written.
const BURST: usize = 64;

/// How often the thread checks whether to end.
const LOOK: Duration = Duration::from_millis(20);

/// Makes the device in the network namespace of the calling thread. The device yields whole packets
/// with checksums: nothing is left to a network card's offloading.
pub(super) fn device(name: &str) -> io::Result<SyncDevice> {
    let device = DeviceBuilder::new()
        .name(name)
        .mtu(MTU)
        .with(|linux| {
            linux.tx_queue_len(KERNEL_PACKETS);
        })
        .build_sync()?;
    device.set_nonblocking(true)?;
    Ok(device)
}

/// A thread that holds packets, until this is dropped.
#[derive(Debug)]
pub(super) struct Delay {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Delay {
    pub(super) fn start(device: SyncDevice, profile: &Profile) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&stop);
        let mut wire = Wire::new(device, profile);
        let thread = thread::Builder::new().name("link".to_owned());
        let thread = thread.spawn(move || {
            while !until.load(Ordering::Relaxed) {
                wire.run_once();
            }
        })?;
        Ok(Self {
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for Delay {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A panic of the thread has no further effect: the device and its packets are gone.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Both directions of the link, through one device.
struct Wire {
    device: SyncDevice,
    to_near: Lane<Vec<u8>>,
    to_far: Lane<Vec<u8>>,
}

impl Wire {
    fn new(device: SyncDevice, profile: &Profile) -> Self {
        let epoch = Instant::now();
        let lane = |salt| Lane::new(profile, epoch, salt);
        Self {
            device,
            to_near: lane(1),
            to_far: lane(2),
        }
    }

    /// Writes all due packets, sleeps until the next event, and reads new packets.
    fn run_once(&mut self) {
        let now = Instant::now();
        for lane in [&mut self.to_near, &mut self.to_far] {
            while let Some(packet) = lane.pop(now) {
                // A packet that the kernel does not take is lost, as on any link.
                let _ = self.device.send(&packet);
            }
        }
        let next = self.to_near.due().into_iter().chain(self.to_far.due());
        let next = next.map(|due| due.saturating_duration_since(now));
        let timeout = next.min().unwrap_or(LOOK).min(LOOK);
        let mut entries = [PollFd::new(self.device.as_fd(), PollFlags::POLLIN)];
        // If waiting fails, reading is tried at once.
        let _ = ppoll(&mut entries, Some(TimeSpec::from_duration(timeout)), None);
        self.read();
    }

    fn read(&mut self) {
        let mut buffer = [0; MTU as usize];
        for _ in 0..BURST {
            let Ok(len) = self.device.recv(&mut buffer) else {
                break;
            };
            let packet = &buffer[..len];
            let lane = match destination(packet) {
                Some(Side::Near) => &mut self.to_near,
                Some(Side::Far) => &mut self.to_far,
                None => continue,
            };
            lane.push(Instant::now(), packet.to_vec());
        }
    }
}

/// The destination host of an IPv4 packet; the link carries no other packets.
fn destination(packet: &[u8]) -> Option<Side> {
    let header = packet.first_chunk::<20>()?;
    if header[0] >> 4 != 4 {
        return None;
    }
    [Side::Near, Side::Far]
        .into_iter()
        .find(|&side| header[16..] == address(side).octets())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(to: [u8; 4]) -> [u8; 28] {
        let mut packet = [0; 28];
        packet[0] = 0x45;
        packet[16..20].copy_from_slice(&to);
        packet
    }

    #[test]
    fn packets_of_other_protocols_and_to_others_go_nowhere() {
        assert_eq!(destination(&packet([10, 77, 1, 1])), Some(Side::Near));
        assert_eq!(destination(&packet([10, 77, 2, 1])), Some(Side::Far));
        assert_eq!(destination(&packet([10, 77, 2, 2])), None);
        assert_eq!(destination(&[0x60; 40]), None);
        assert_eq!(destination(&packet([10, 77, 1, 1])[..19]), None);
    }
}
