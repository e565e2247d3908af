//! A recorder of Zenoh's topics: its threads pass the messages to the crate `mcap`.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{
    control::{Stage, wait_for},
    job::Recording,
    peers::{
        contract::{Flow, Handler, Peer, PeerError},
        mcap_file::McapFile,
    },
};

/// The file and the first error of writing it.
struct State {
    file: Option<McapFile>,
    failed: Option<PeerError>,
}

fn lock_state(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The handler of one topic.
struct Topic {
    number: usize,
    state: Arc<Mutex<State>>,
}

impl Handler for Topic {
    fn message(&mut self, message: &[u8]) -> Flow {
        let mut state = lock_state(&self.state);
        if let Some(Err(error)) = state.file.as_mut().map(|it| it.write(self.number, message)) {
            state.file = None;
            state.failed = Some(error);
        }
        Flow::Continue
    }
}

/// Records until the director sends `stop`.
pub(super) fn record(
    peer: &impl Peer,
    recording: &Recording,
    ready: impl FnOnce(),
) -> Result<(), PeerError> {
    let channels = recording.channels();
    let topics = channels.iter().map(|it| it.name.as_str());
    let state = Arc::new(Mutex::new(State {
        file: Some(McapFile::create(&recording.file, topics)?),
        failed: None,
    }));
    let mut subscribers = Vec::new();
    for (number, channel) in channels.iter().enumerate() {
        let state = Arc::clone(&state);
        subscribers.push(peer.subscriber(channel, Topic { number, state })?);
    }
    ready();
    wait_for(Stage::Stop);
    // Zenoh calls no handler of a subscriber that is gone.
    drop(subscribers);
    let mut state = lock_state(&state);
    match (state.failed.take(), state.file.take()) {
        (Some(error), _) => Err(error),
        (None, Some(file)) => file.finish(),
        (None, None) => Err(PeerError::new("write the file", "it is closed already")),
    }
}
