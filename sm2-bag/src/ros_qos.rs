//! The QoS of publishers in the form of rosbag2: a YAML sequence of mappings, one for each publisher of a topic.

use sm2_proto::{OfferedQos, Period};

/// The key in the metadata of a channel.
pub(crate) const KEY: &str = "offered_qos_profiles";
/// The number of messages that wait for a subscriber. The history depth of the recorded publisher is not used: it is
/// small for the usual publisher, and the messages of a bag that is played fast come in bursts.
const DEPTH: u16 = 64;
/// The seconds and nanoseconds that mean in ROS 2 that there is no deadline, lifespan or lease.
const NONE: (u64, u64) = (9_223_372_036, 854_775_807);

/// Writes the QoS of one publisher.
pub(crate) fn write(offer: &OfferedQos) -> String {
    let OfferedQos {
        depth,
        reliable,
        latched,
        deadline,
        lifespan,
        lease,
        sealed: _,
    } = *offer;
    let reliability = if reliable { "reliable" } else { "best_effort" };
    let durability = match latched {
        0 => "volatile",
        _ => "transient_local",
    };
    let liveliness = match lease {
        Period::NONE => "automatic",
        _ => "manual_by_topic",
    };
    let depth = depth.max(latched);
    let [deadline, lifespan, lease] = [deadline, lifespan, lease].map(duration);
    format!(
        "- history: keep_last\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n  \
         deadline:{deadline}\n  lifespan:{lifespan}\n  liveliness: {liveliness}\n  \
         liveliness_lease_duration:{lease}\n  avoid_ros_namespace_conventions: false"
    )
}

fn duration(period: Period) -> String {
    let (sec, nsec) = match period {
        Period::NONE => NONE,
        Period(ns) => (ns / 1_000_000_000, ns % 1_000_000_000),
    };
    format!("\n    sec: {sec}\n    nsec: {nsec}")
}

/// Reads reliability and durability from the QoS of the recorded publishers. A property counts as the weaker one if a
/// publisher has it. Both are words, or numbers in bags before ROS 2 Jazzy: reliability 2 is best effort, durability 1
/// transient local. Without any, the publisher is reliable and not latched.
pub(crate) fn read(yaml: &str) -> OfferedQos {
    let values = |key: &str| {
        let lines = yaml.lines().filter_map(|line| line.split_once(':'));
        let key = key.to_owned();
        lines
            .filter(move |(name, _)| name.trim_start_matches([' ', '-']).trim_end() == key)
            .map(|(_, value)| value.trim())
    };
    let is_reliable = !values("reliability").any(|it| it == "best_effort" || it == "2");
    let mut durabilities = values("durability").peekable();
    let is_latched = durabilities.peek().is_some()
        && durabilities.all(|it| it == "transient_local" || it == "1");
    OfferedQos {
        reliable: is_reliable,
        latched: if is_latched { DEPTH } else { 0 },
        ..OfferedQos::new(DEPTH)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reliability_and_durability_are_words_or_numbers() {
        let qos = |yaml: &str| {
            let offer = read(yaml);
            (offer.reliable, offer.latched)
        };
        let words = "- history: keep_last\n  depth: 5\n  reliability: best_effort\n  \
                     durability: transient_local\n  deadline:\n    sec: 1\n    nsec: 2\n";
        assert_eq!(qos(words), (false, DEPTH));
        let first = "- reliability: reliable\n  durability: volatile\n";
        assert_eq!(qos(first), (true, 0));
        assert_eq!(qos(&format!("{first}{words}")), (false, 0));
        assert_eq!(qos("- reliability: 1\n  durability: 1\n"), (true, DEPTH));
        assert_eq!(qos("- reliability: 2\n  durability: 2\n"), (false, 0));
        assert_eq!(qos(""), (true, 0));
    }

    /// `sm2-bag/oracle` reads it with the Python package rosbags.
    #[test]
    fn the_qos_of_a_publisher_has_the_form_of_rosbag2() {
        let offer = OfferedQos {
            reliable: true,
            latched: 5,
            sealed: true,
            deadline: Period(2_000_000_007),
            lease: Period(9),
            ..OfferedQos::new(3)
        };
        let expected = "- history: keep_last\n  depth: 5\n  reliability: reliable\n  durability: transient_local\n  \
                        deadline:\n    sec: 2\n    nsec: 7\n  \
                        lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: manual_by_topic\n  \
                        liveliness_lease_duration:\n    sec: 0\n    nsec: 9\n  \
                        avoid_ros_namespace_conventions: false";
        assert_eq!(write(&offer), expected);
        let read = read(&write(&offer));
        assert_eq!((read.reliable, read.latched), (true, DEPTH));
        let offer = OfferedQos {
            reliable: false,
            latched: 0,
            ..offer
        };
        let read = super::read(&write(&offer));
        assert_eq!((read.reliable, read.latched), (false, 0));
    }
}
