//! The publishers and the recorder of a recording.

use nix::unistd::Pid;

use super::Failure;
use crate::{
    clock::{now_ns, sleep_until},
    control::{Stage, reached, send_event, wait_for},
    job::{Domain, Framed, Frames, Outcome, ProcessEvent, Recorded, Recording, SmallTopics},
    measure,
    payload::{Header, fill},
    peers::{Peer, Publish},
};

/// The peer whose recorder leaves the processor to others.
const IDLE_RECORDER: &str = "sm2-idle";

/// The time between two ticks of the small topics, in nanoseconds.
const TICK_NS: u64 = 1_000_000;

/// Publishes the frames, and waits until all subscribers have taken them.
pub(super) fn frames<P: Peer>(domain: &Domain, frames: &Frames) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "frames", false)?;
    let mut publisher = peer.publisher(&frames.channel)?;
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    publisher.wait_matched(frames.channel.subscribers)?;
    let start_ns = now_ns();
    let mut busy_ns = 0;
    for number in 0..frames.count {
        if let Some(rate) = frames.rate_hz {
            let before_ns = now_ns();
            sleep_until(start_ns + (number as f64 * 1e9 / rate) as u64);
            busy_ns += now_ns() - before_ns;
        }
        publisher.publish(frames.len, |message| {
            let before_ns = now_ns();
            let header = Header {
                number,
                start_ns: before_ns,
                ..Header::default()
            };
            fill(header, message);
            busy_ns += now_ns() - before_ns;
        })?;
    }
    publisher.flush()?;
    let end_ns = now_ns();
    // Subscribers read from this process' memory until the director ends it.
    send_event(&ProcessEvent::Done(Outcome::Framed(Framed {
        count: frames.count,
        start_ns,
        end_ns,
        blocked_ns: (end_ns - start_ns).saturating_sub(busy_ns),
    })))?;
    wait_for(Stage::End);
    Ok(Outcome::Nothing)
}

/// Publishes small messages until `stop`. In each millisecond, an equal part of the channels has its turn, as if many
/// independent nodes published.
pub(super) fn small_topics<P: Peer>(
    domain: &Domain,
    topics: &SmallTopics,
) -> Result<Outcome, Failure> {
    let peer = P::open(domain, "small", false)?;
    let channels = topics.channels.iter();
    let publishers: Result<Vec<_>, _> = channels.map(|it| peer.publisher(it)).collect();
    let mut publishers = publishers?;
    send_event(&ProcessEvent::Ready)?;
    wait_for(Stage::Go);
    for (publisher, channel) in publishers.iter_mut().zip(&topics.channels) {
        publisher.wait_matched(channel.subscribers)?;
    }
    let mut published = vec![0; publishers.len()];
    let groups = (1_000 / topics.rate_hz.max(1)).max(1);
    let start_ns = now_ns();
    for tick in 0.. {
        sleep_until(start_ns + tick * TICK_NS);
        if reached(Stage::Stop) {
            break;
        }
        for (at, publisher) in publishers.iter_mut().enumerate() {
            if at as u64 % groups != tick % groups {
                continue;
            }
            let header = Header {
                number: published[at],
                start_ns: now_ns(),
                ..Header::default()
            };
            publisher.publish(topics.len, |message| fill(header, message))?;
            published[at] += 1;
        }
    }
    for publisher in &mut publishers {
        publisher.flush()?;
    }
    let outcome = Outcome::SmallTopics { published };
    send_event(&ProcessEvent::Done(outcome))?;
    wait_for(Stage::End);
    Ok(Outcome::Nothing)
}

/// Records until `stop`.
pub(super) fn record<P: Peer>(domain: &Domain, recording: &Recording) -> Result<Outcome, Failure> {
    if domain.peer == IDLE_RECORDER {
        // Threads that start later inherit the policy.
        sm2_io::run_when_idle()?;
    }
    let peer = P::open(domain, "recorder", false)?;
    let mut begun = Ok((0, 0));
    peer.record(recording, || {
        begun = (|| {
            let cpu_ns = measure::cpu_ns(Pid::this())?;
            send_event(&ProcessEvent::Ready)?;
            Ok::<_, std::io::Error>((now_ns(), cpu_ns))
        })();
    })?;
    let (start_ns, cpu_ns) = begun?;
    Ok(Outcome::Recorded(Recorded {
        start_ns,
        done_ns: now_ns(),
        cpu_ns: measure::cpu_ns(Pid::this())? - cpu_ns,
        file_bytes: std::fs::metadata(&recording.file)?.len(),
    }))
}
