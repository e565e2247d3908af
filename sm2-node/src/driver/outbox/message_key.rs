//! The keys under which an outbox stores messages.

/// The key of a stored message: the index of an entry in the outbox, and how often that entry was
/// used. A stale key therefore names no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct MessageKey {
    pub(super) generation: u32,
    pub(super) index: u32,
}

impl MessageKey {
    /// Encodes the key for the machine of a link.
    pub(in crate::driver) const fn to_raw(self) -> u64 {
        (self.generation as u64) << 32 | self.index as u64
    }

    /// Decodes a key that [`to_raw`](Self::to_raw) encoded.
    pub(in crate::driver) const fn from_raw(raw: u64) -> Self {
        Self {
            generation: (raw >> 32) as u32,
            index: raw as u32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_comes_back_from_its_number_and_no_two_have_the_same() {
        let ends = [0, 1, u32::MAX - 1, u32::MAX];
        let keys = ends.map(|generation| ends.map(|index| MessageKey { generation, index }));
        let keys = keys.as_flattened();
        for key in keys {
            assert_eq!(MessageKey::from_raw(key.to_raw()), *key);
            let same = keys.iter().filter(|it| it.to_raw() == key.to_raw());
            assert_eq!(same.count(), 1, "{key:?}");
        }
    }
}
