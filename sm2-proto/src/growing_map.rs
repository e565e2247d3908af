//! A map whose keys mostly grow, and whose first keys are mostly removed first.

use alloc::collections::{VecDeque, vec_deque};

/// A sorted queue of keys with their values.
///
/// A new key is usually the greatest, and usually the least key is removed: both take constant time, and allocate
/// nothing once there was room for as many entries. A tree would allocate for the first entry each time.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct GrowingMap<K, V>(VecDeque<(K, V)>);

impl<K, V> Default for GrowingMap<K, V> {
    fn default() -> Self {
        Self::new()
    }
}

impl<K, V> GrowingMap<K, V> {
    /// Creates an empty map.
    #[must_use]
    pub const fn new() -> Self {
        Self(VecDeque::new())
    }

    /// The number of keys.
    #[must_use]
    #[inline]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is no key.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The keys and values, ordered by key.
    pub fn iter_mut(&mut self) -> vec_deque::IterMut<'_, (K, V)> {
        self.0.iter_mut()
    }

    /// The values, ordered by key.
    pub fn values(&self) -> impl Iterator<Item = &V> {
        self.0.iter().map(|it| &it.1)
    }

    /// Removes all keys, and returns them in order.
    pub fn into_keys(self) -> impl Iterator<Item = K> {
        self.0.into_iter().map(|it| it.0)
    }

    /// Removes all keys.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

impl<K: Copy + Ord, V> GrowingMap<K, V> {
    #[inline]
    fn place(&self, key: K) -> Result<usize, usize> {
        match self.0.back() {
            None => Err(0),
            Some((last, _)) if *last < key => Err(self.0.len()),
            Some((last, _)) if *last == key => Ok(self.0.len() - 1),
            Some(_) => self.0.binary_search_by_key(&key, |it| it.0),
        }
    }

    /// The value of a key.
    #[must_use]
    #[inline]
    pub fn get(&self, key: K) -> Option<&V> {
        let place = self.place(key).ok()?;
        self.0.get(place).map(|it| &it.1)
    }

    /// The value of a key, to change it.
    #[must_use]
    #[inline]
    pub fn get_mut(&mut self, key: K) -> Option<&mut V> {
        let place = self.place(key).ok()?;
        self.0.get_mut(place).map(|it| &mut it.1)
    }

    /// Adds a key, or replaces its value.
    #[inline]
    pub fn insert(&mut self, key: K, value: V) {
        match self.place(key) {
            Ok(place) => {
                if let Some(entry) = self.0.get_mut(place) {
                    entry.1 = value;
                }
            }
            Err(place) => self.0.insert(place, (key, value)),
        }
    }

    /// Removes a key, and returns its value.
    #[inline]
    pub fn remove(&mut self, key: K) -> Option<V> {
        let place = self.place(key).ok()?;
        self.0.remove(place).map(|it| it.1)
    }
}

impl<K: Copy + Ord, V> FromIterator<(K, V)> for GrowingMap<K, V> {
    fn from_iter<I: IntoIterator<Item = (K, V)>>(entries: I) -> Self {
        let mut map = Self::new();
        for (key, value) in entries {
            map.insert(key, value);
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;
    use alloc::vec::Vec;

    use proptest::prelude::*;

    use super::GrowingMap;

    proptest! {
        #[test]
        fn it_does_what_a_tree_does(steps in proptest::collection::vec((0..3_u8, 0..12_u8, any::<u8>()), 0..80)) {
            let (mut map, mut tree) = (GrowingMap::default(), BTreeMap::new());
            for (step, key, value) in steps {
                match step {
                    0 => {
                        map.insert(key, value);
                        tree.insert(key, value);
                    }
                    1 => prop_assert_eq!(map.remove(key), tree.remove(&key)),
                    _ => {
                        let (mine, its) = (map.get_mut(key), tree.get_mut(&key));
                        prop_assert_eq!(&mine, &its);
                        if let (Some(mine), Some(its)) = (mine, its) {
                            (*mine, *its) = (value, value);
                        }
                    }
                }
                prop_assert_eq!(map.get(key), tree.get(&key));
                prop_assert_eq!((map.len(), map.is_empty()), (tree.len(), tree.is_empty()));
                prop_assert!(map.values().eq(tree.values()));
            }
            prop_assert!(map.iter_mut().map(|it| it.0).eq(tree.keys().copied()));
            let keys: Vec<_> = map.into_keys().collect();
            prop_assert!(keys.into_iter().eq(tree.into_keys()));
        }
    }
}
