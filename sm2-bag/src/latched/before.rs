//! The latched state of bags as of a time.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use mcap::Channel;
use mcap::records::ChunkIndex;

use super::{Key, channels};
use crate::bag::Bag;
use crate::error::ReadError;
use crate::merged::Found;
use crate::messages::{Filter, FoundMessage};

/// The last messages of a publisher, by the time of publication and the number.
struct State<'a> {
    latched: usize,
    messages: BTreeMap<(u64, u32, u64), (usize, FoundMessage<'a>)>,
}

/// A bag whose latched channels are read.
struct Latched {
    /// The publishers of its channels.
    keys: HashMap<u16, Key>,
    channels: HashMap<u16, Arc<Channel<'static>>>,
}

/// The messages that a subscriber would have received at `at_ns` from the latched publishers whose topics pass the
/// filter, in the order of their publication, each with the number of its bag. Their `log_time` is `at_ns`, and they
/// are repeated. Faults come first; there is nothing behind one that is not damage. Only chunks that may have one of
/// the messages are read.
pub(super) fn before<'a>(bags: &'a [Bag], filter: &Filter, at_ns: u64) -> Vec<Found<'a>> {
    let filter = Filter {
        from_ns: None,
        to_ns: Some(at_ns),
        ..filter.clone()
    };
    let mut states = BTreeMap::<Key, State<'a>>::new();
    let mut latched = Vec::new();
    let mut chunks = Vec::new();
    for (number, bag) in bags.iter().enumerate() {
        let of_bag = Latched::of(bag, &filter, &mut states);
        let may_have = |it: &&ChunkIndex| {
            it.message_start_time < at_ns && of_bag.keys.keys().any(|id| may_have(it, *id))
        };
        let chosen = bag.places().filter(may_have);
        chunks.extend(chosen.map(|it| (number, it)));
        latched.push(of_bag);
    }
    chunks.sort_by_key(|(_, it)| Reverse(it.message_end_time));
    let mut found = Vec::new();
    for (number, chunk) in chunks {
        let of_bag = &latched[number];
        let can_add = |(id, key): (&u16, &Key)| {
            may_have(chunk, *id) && states[key].can_be_older_than(chunk.message_end_time)
        };
        if !of_bag.keys.iter().any(can_add) {
            continue;
        }
        let mut messages = bags[number].messages_at(chunk, &of_bag.channels, &filter);
        while let Some(message) = messages.find().transpose() {
            match message {
                Ok(message) => {
                    let key = of_bag.keys.get(&message.channel.id);
                    if let Some(state) = key.and_then(|it| states.get_mut(it)) {
                        state.add(number, message);
                    }
                }
                Err(error) => {
                    let is_damage = matches!(error, ReadError::Damaged { .. });
                    found.push((number, Err(error)));
                    if !is_damage {
                        return found;
                    }
                }
            }
        }
    }
    let all = states.into_values().flat_map(|it| it.messages);
    let mut all: Vec<_> = all.collect();
    all.sort_by_key(|(place, _)| *place);
    found.extend(all.into_iter().map(|(_, (number, message))| {
        let message = FoundMessage {
            log_time: at_ns,
            is_repeated: true,
            ..message
        };
        (number, Ok(message))
    }));
    found
}

/// Whether a chunk may have messages of a channel. An index without channels says nothing.
fn may_have(chunk: &ChunkIndex, channel: u16) -> bool {
    let indexed = &chunk.message_index_offsets;
    indexed.is_empty() || indexed.contains_key(&channel)
}

impl Latched {
    fn of<'a>(bag: &Bag, filter: &Filter, states: &mut BTreeMap<Key, State<'a>>) -> Self {
        let chosen = channels(bag).filter(|it| filter.has_topic(&it.0.topic));
        let mut keys = HashMap::new();
        for (channel, key, latched) in chosen {
            let messages = BTreeMap::new();
            let state = states
                .entry(key.clone())
                .or_insert(State { latched, messages });
            state.latched = state.latched.max(latched);
            keys.insert(channel.id, key);
        }
        let ids: BTreeSet<_> = keys.keys().copied().collect();
        let read = bag.channels().filter(|it| ids.contains(&it.id));
        Self {
            channels: read.map(|it| (it.id, Arc::clone(it))).collect(),
            keys,
        }
    }
}

impl<'a> State<'a> {
    /// Whether one of its messages lacks, or was recorded at this time or before.
    fn can_be_older_than(&self, log_time: u64) -> bool {
        // A file may repeat an older message, and have no room for the one behind it.
        let recorded = |it: &FoundMessage<'_>| match it.is_repeated {
            true => it.publish_time,
            false => it.log_time,
        };
        let oldest = self.messages.values().map(|(_, it)| recorded(it)).min();
        self.messages.len() < self.latched || oldest.is_none_or(|it| it <= log_time)
    }

    /// Adds a message, unless it is a repeated one that is there already.
    fn add(&mut self, bag: usize, message: FoundMessage<'a>) {
        let (published, sequence) = (message.publish_time, message.sequence);
        let same = (published, sequence, 0)..=(published, sequence, u64::MAX);
        if message.is_repeated {
            if self.messages.range(same).next().is_some() {
                return;
            }
        } else {
            let mut others = self.messages.range(same);
            let repeated = others.find(|(_, (_, it))| it.is_repeated);
            if let Some(place) = repeated.map(|it| *it.0) {
                self.messages.remove(&place);
            }
        }
        let place = (published, sequence, message.log_time);
        self.messages.insert(place, (bag, message));
        if self.messages.len() > self.latched {
            self.messages.pop_first();
        }
    }
}
