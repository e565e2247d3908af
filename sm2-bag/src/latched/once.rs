//! Repeated messages that were read before.

use std::collections::{BTreeMap, HashMap, VecDeque};

use super::{Key, channels};
use crate::bag::Bag;
use crate::messages::FoundMessage;
use crate::repeated::is_repeated;

/// So many messages more than are latched are remembered of each publisher: a polled message can come before the
/// repeated ones of its file.
const MORE: usize = 64;

/// Lets each repeated message of several bags pass once, and not at all behind the original.
pub(super) struct Once {
    /// The place of the publisher of each latched channel, by the number of the bag and that of the channel.
    channels: HashMap<(usize, u16), usize>,
    publishers: Vec<Publisher>,
}

#[derive(Default)]
struct Publisher {
    latched: usize,
    /// The times of publication and the numbers of the last messages.
    last: VecDeque<(u64, u32)>,
}

impl Once {
    pub(super) fn new(bags: &[Bag]) -> Self {
        let mut places = BTreeMap::<Key, usize>::new();
        let mut once = Self {
            channels: HashMap::new(),
            publishers: Vec::new(),
        };
        for (number, bag) in bags.iter().enumerate() {
            for (channel, key, latched) in channels(bag) {
                let place = *places.entry(key).or_insert_with(|| {
                    once.publishers.push(Publisher::default());
                    once.publishers.len() - 1
                });
                let publisher = &mut once.publishers[place];
                publisher.latched = publisher.latched.max(latched);
                once.channels.insert((number, channel.id), place);
            }
        }
        once
    }

    /// Whether a message of the bag with this number passes. Messages come in the order of their `log_time`.
    pub(super) fn admits(&mut self, bag: usize, message: &FoundMessage<'_>) -> bool {
        let Some(&place) = self.channels.get(&(bag, message.channel.id)) else {
            return true;
        };
        let publisher = &mut self.publishers[place];
        let it = (message.publish_time, message.sequence);
        if is_repeated(&message.channel) && publisher.last.contains(&it) {
            return false;
        }
        publisher.last.push_back(it);
        if publisher.last.len() > publisher.latched + MORE {
            publisher.last.pop_front();
        }
        true
    }
}
