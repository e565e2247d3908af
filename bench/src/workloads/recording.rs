//! The processes that `record` and `seek` share: a recorder, frames, and 50 topics of small messages.

use std::{path::Path, time::Duration};

use crate::{
    job::{Channel, DiskWork, Framed, Frames, Outcome, Recorded, Recording, Role, SmallTopics},
    world::{Failure, ProcessId, TIMEOUT, World},
};

/// The number of topics with small messages.
const SMALL_TOPICS: usize = 50;

/// The length of small messages, in bytes.
const SMALL_LEN: usize = 200;

/// Small messages per second on each topic.
const SMALL_RATE_HZ: u64 = 100;

/// The interval of `fdatasync(2)`, in milliseconds: the default of `sm2 record`.
const SYNC_MS: u64 = 100;

/// A disk that is slower than this fails the run, in bytes per second.
const SLOWEST: u64 = 10_000_000;

/// The topic of the frames.
pub(super) const FRAMES: &str = "bench/frames";

/// The topics and the amount of data of one recording.
#[derive(Clone, Debug)]
pub(super) struct Load {
    /// The length of each frame, in bytes.
    pub(super) len: usize,
    /// The number of frames.
    pub(super) count: u64,
    /// Frames per second; `None` is as fast as the recorder takes them.
    pub(super) rate_hz: Option<f64>,
}

impl Load {
    /// Frames of this length, `gigabytes` in total.
    pub(super) fn new(len: usize, gigabytes: f64, rate_hz: Option<f64>) -> Self {
        let count = (gigabytes * 1e9 / len as f64).round() as u64;
        Self {
            len,
            count: count.max(1),
            rate_hz,
        }
    }

    /// The length of all frames, in bytes.
    pub(super) const fn bytes(&self) -> u64 {
        self.count * self.len as u64
    }

    /// The longest time that publishing and writing may take.
    pub(super) fn limit(&self) -> Duration {
        let paced = self.rate_hz.map_or(0.0, |rate| self.count as f64 / rate);
        TIMEOUT + Duration::from_secs(self.bytes() / SLOWEST) + Duration::from_secs_f64(paced)
    }

    fn frames(&self, subscribers: usize) -> Channel {
        Channel {
            name: FRAMES.to_owned(),
            max_len: self.len,
            depth: 8,
            lossless: true,
            subscribers,
        }
    }

    /// The work of a process that writes as many bytes without a middleware.
    pub(super) fn disk_work(&self, file: &Path) -> DiskWork {
        DiskWork {
            file: file.to_owned(),
            len: self.len,
            count: self.count,
            sync_ms: SYNC_MS,
        }
    }
}

fn small(subscribers: usize) -> Vec<Channel> {
    let channel = |number| Channel {
        name: format!("bench/small/{number}"),
        max_len: SMALL_LEN,
        depth: 64,
        lossless: false,
        subscribers,
    };
    (0..SMALL_TOPICS).map(channel).collect()
}

/// The processes of one recording.
pub(super) struct Rig<'a> {
    load: &'a Load,
    recorder: Option<ProcessId>,
    frames: Option<ProcessId>,
    small: ProcessId,
}

/// The reports of the processes of a recording.
#[derive(Debug)]
pub(super) struct Done {
    pub(super) framed: Option<Framed>,
    pub(super) recorded: Option<Recorded>,
    /// The topics with small messages, and the number of messages that were published on each.
    pub(super) small: Vec<(String, u64)>,
}

impl<'a> Rig<'a> {
    /// Starts the publishers, and a recorder if there is a file. Nothing is published before [`go`](Self::go).
    pub(super) fn start(
        world: &mut World,
        load: &'a Load,
        file: Option<&Path>,
        has_frames: bool,
    ) -> Result<Self, Failure> {
        let subscribers = usize::from(file.is_some());
        let recorder = match file {
            Some(file) => Some(ready(
                world,
                "recorder",
                Role::Recorder(Recording {
                    file: file.to_owned(),
                    frames: load.frames(1),
                    small: small(1),
                    sync_ms: SYNC_MS,
                }),
            )?),
            None => None,
        };
        let topics = SmallTopics {
            channels: small(subscribers),
            len: SMALL_LEN,
            rate_hz: SMALL_RATE_HZ,
        };
        let small = ready(world, "small", Role::SmallTopics(topics))?;
        let frames = Frames {
            channel: load.frames(subscribers),
            len: load.len,
            count: load.count,
            rate_hz: load.rate_hz,
        };
        let frames = match has_frames {
            true => Some(ready(world, "frames", Role::Frames(frames))?),
            false => None,
        };
        Ok(Self {
            load,
            recorder,
            frames,
            small,
        })
    }

    /// Lets the publishers begin.
    pub(super) fn go(&self, world: &mut World) {
        world.send_word(self.small, "go");
        if let Some(frames) = self.frames {
            world.send_word(frames, "go");
        }
    }

    /// Waits until all frames were taken, ends the small messages and then the recorder.
    pub(super) fn finish(&self, world: &mut World) -> Result<Done, Failure> {
        let limit = self.load.limit();
        let framed = match self.frames {
            Some(frames) => match world.outcome(frames, limit)? {
                Outcome::Framed(framed) => Some(framed),
                _ => None,
            },
            None => None,
        };
        world.send_word(self.small, "stop");
        let small = match world.outcome(self.small, TIMEOUT)? {
            Outcome::SmallTopics { published } => {
                let names = small(0).into_iter().map(|it| it.name);
                names.zip(published).collect()
            }
            _ => Vec::new(),
        };
        let recorded = match self.recorder {
            Some(recorder) => {
                world.send_word(recorder, "stop");
                recorded(world, recorder, limit)?
            }
            None => None,
        };
        Ok(Done {
            framed,
            recorded,
            small,
        })
    }
}

/// Starts a process and waits until it is ready.
pub(super) fn ready(world: &mut World, name: &str, role: Role) -> Result<ProcessId, Failure> {
    let process = world.start(name, role)?;
    world.ready(process)?;
    Ok(process)
}

/// Writes as many bytes as the frames have, without a middleware.
pub(super) fn write_blocks(
    world: &mut World,
    load: &Load,
    file: &Path,
) -> Result<Option<Recorded>, Failure> {
    let role = Role::DiskWriter(load.disk_work(file));
    let writer = ready(world, "disk", role)?;
    world.send_word(writer, "go");
    let written = recorded(world, writer, load.limit())?;
    world.end(writer);
    Ok(written)
}

fn recorded(
    world: &mut World,
    process: ProcessId,
    limit: Duration,
) -> Result<Option<Recorded>, Failure> {
    match world.outcome(process, limit)? {
        Outcome::Recorded(recorded) => Ok(Some(recorded)),
        _ => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::Load;

    #[test]
    fn the_number_of_frames_follows_from_the_amount_of_data() {
        assert_eq!(Load::new(10_000_000, 4.0, None).count, 400);
        assert_eq!(Load::new(10_000_000, 0.001, None).bytes(), 10_000_000);
        let paced = Load::new(10_000_000, 1.0, Some(2.0)).limit();
        assert!(paced >= std::time::Duration::from_secs(50), "{paced:?}");
    }
}
