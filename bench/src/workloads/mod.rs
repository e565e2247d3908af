//! The workloads. A workload is a list of cases; each case runs on every peer in turn.
//!
//! To add a workload, add a module and an entry in [`WORKLOADS`].

use crate::{
    link,
    peers::{Part, PeerInfo, Reach},
};

mod bad_link;
mod case;
mod fig3;
mod fig4;
mod fig5;
mod join;
mod nodes;
mod pingpong;
mod record;
mod recording;
mod seek;
mod service;
mod stream;
mod throughput;

pub use case::{Case, Figure, Options, figure};

/// A workload of the command line.
#[derive(Debug)]
pub struct Workload {
    /// The name on the command line.
    pub name: &'static str,
    /// A description in one line.
    pub about: &'static str,
    /// Makes the cases.
    pub cases: fn(&Options) -> Vec<Box<dyn Case>>,
    /// The figures in tables and plots; the results contain all figures.
    pub shown: &'static [&'static str],
    /// Checks that a peer can run the workload; the error says why not.
    pub supports: fn(&PeerInfo) -> Result<(), &'static str>,
    /// Checks that this machine can run the workload; the error says why not.
    pub available: fn() -> Result<(), String>,
}

/// All workloads.
pub const WORKLOADS: &[Workload] = &[
    Workload {
        name: "fig3",
        about: "10 MB at 10 Hz, 1 to 1 and 1 to 5: CPU and memory of all processes",
        cases: fig3::cases,
        shown: &["cpu", "pss", "latency_mean", "dropped", "torn"],
        supports: moves_messages,
        available: anywhere,
    },
    Workload {
        name: "fig4",
        about: "10 MB, 1 to 5, target 10 to 800 Hz: achieved rate and latency",
        cases: fig4::cases,
        shown: &["received_hz", "latency_mean", "latency_p99"],
        supports: moves_messages,
        available: anywhere,
    },
    Workload {
        name: "fig4-max",
        about: "10 MB, 1 to 5, as fast as possible",
        cases: fig4::cases_max,
        shown: &[
            "received_hz",
            "dropped",
            "torn",
            "latency_mean",
            "latency_p99",
            "cpu",
        ],
        supports: everybody,
        available: anywhere,
    },
    Workload {
        name: "fig5",
        about: "10 MB at 10 Hz, 1 to 1 up to 1 to 8: latency",
        cases: fig5::cases,
        shown: &["latency_mean", "latency_p99"],
        supports: moves_messages,
        available: anywhere,
    },
    Workload {
        name: "pingpong",
        about: "64 B to 1 MB there and back: one-way latency",
        cases: pingpong::cases,
        shown: &["half_round_trip_p50", "one_way_by_stamp_p50"],
        supports: sends_one_by_one,
        available: anywhere,
    },
    Workload {
        name: "throughput",
        about: "64 B messages, 1 to 1, none lost: messages per second",
        cases: throughput::cases,
        shown: &["received_hz", "lost", "torn", "cpu"],
        supports: loses_nothing,
        available: anywhere,
    },
    Workload {
        name: "nodes",
        about: "50 and 100 nodes join, and then are idle: time, CPU, wake-ups, memory",
        cases: nodes::cases,
        shown: &[
            "all_ready",
            "cpu_to_settle",
            "idle_cpu",
            "idle_wakeups",
            "pss",
        ],
        supports: has_nodes,
        available: anywhere,
    },
    Workload {
        name: "join",
        about: "from process start to the first message of a running 1 kHz publisher",
        cases: join::cases,
        shown: &["first_message_p50", "first_message_max"],
        supports: moves_messages,
        available: anywhere,
    },
    Workload {
        name: "service",
        about: "64 B request and reply: round trip",
        cases: service::cases,
        shown: &["round_trip_p50", "round_trip_p99", "torn"],
        supports: has_services,
        available: anywhere,
    },
    Workload {
        name: "bad-link",
        about: "1 MB at 30 Hz to a local subscriber, and to a remote one over 30.8 Mbit/s, 15 ms and 0 or 4 % loss",
        cases: bad_link::cases,
        shown: &[
            "remote_goodput",
            "remote_share",
            "remote_hz",
            "remote_age_p50",
            "remote_age_p99",
            "local_hz_before",
            "local_hz_after",
            "local_latency_p99_before",
            "local_latency_p99_after",
            "local_dropped",
            "torn",
            "cpu_near",
        ],
        supports: crosses_a_link,
        available: link::available,
    },
    Workload {
        name: "record",
        about: "10 MB frames, none lost, and 50 topics of 200 B at 100 Hz, recorded beside another subscriber",
        cases: record::cases,
        shown: &[
            "written",
            "disk_alone",
            "ratio_to_disk",
            "frames_lost",
            "small_lost",
            "torn",
            "recorder_cpu",
            "cpu_at_1GBps",
            "publisher_blocked",
            "other_p99_with",
            "other_p99_without",
            "other_p99_ratio",
        ],
        supports: records,
        available: anywhere,
    },
    Workload {
        name: "seek",
        about: "the first message from a random time on in a bag of 20 GB, without the page cache",
        cases: seek::cases,
        shown: &[
            "first_message_p50",
            "first_message_max",
            "first_frame_p50",
            "first_frame_max",
            "open_p50",
            "open_max",
            "peak_rss",
            "fetched_mean",
            "bag",
        ],
        supports: has_bags,
        available: anywhere,
    },
];

/// The workload of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Workload> {
    WORKLOADS.iter().find(|workload| workload.name == name)
}

const fn anywhere() -> Result<(), String> {
    Ok(())
}

const fn everybody(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.part {
        Part::OneToOne => Err("this program compares it in pingpong and throughput alone"),
        _ => sends_one_by_one(peer),
    }
}

const fn sends_one_by_one(peer: &PeerInfo) -> Result<(), &'static str> {
    match (peer.part, peer.reach) {
        (Part::Record, _) => Err(RECORD_ALONE),
        (Part::Batches, _) => Err("it differs from sm2 only with many messages per call"),
        (_, Reach::LinkAlone) => Err("it needs two hosts"),
        (_, Reach::Host | Reach::Link) => Ok(()),
    }
}

const fn crosses_a_link(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.reach {
        Reach::Host => {
            Err("it runs at one host only, or this program does not use its network transport")
        }
        Reach::Link | Reach::LinkAlone => Ok(()),
    }
}

fn moves_messages(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.name {
        "raw-memcpy" => Err("it has one process and no communication"),
        _ if peer.part == Part::OtherLanguage => Err(OTHER_LANGUAGE),
        _ => everybody(peer),
    }
}

/// The reason why a peer in another language does not run the other workloads.
const OTHER_LANGUAGE: &str = "this program compares it in fig4-max, pingpong and throughput alone";

/// The reason why a recorder does not run the other workloads.
const RECORD_ALONE: &str = "it is a recorder: it runs in record alone";

fn loses_nothing(peer: &PeerInfo) -> Result<(), &'static str> {
    match (peer.part, peer.lossy) {
        (Part::Record, _) => Err(RECORD_ALONE),
        (_, true) => Err("it drops messages by design"),
        (_, false) => Ok(()),
    }
}

fn records(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.part == Part::Record || peer.name == "sm2" {
        true => Ok(()),
        false => Err("it is not a recorder"),
    }
}

fn has_bags(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.name {
        "sm2" => Ok(()),
        _ => Err("its files are not read by sm2-bag, or by the same code"),
    }
}

const fn has_nodes(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.has.nodes {
        true => everybody(peer),
        false => Err("it has no nodes, or its nodes do not sleep"),
    }
}

const fn has_services(peer: &PeerInfo) -> Result<(), &'static str> {
    match peer.has.services {
        true => everybody(peer),
        false => Err("it has no services, or this program does not use them"),
    }
}

#[cfg(test)]
mod tests;
