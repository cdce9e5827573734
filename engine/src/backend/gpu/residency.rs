//! What stays on the device between calls: the assets used last, within a number of bytes.

use std::collections::HashMap;
use std::hash::Hash;

/// Keys of what is on the device with their bytes. What is in use is pinned and stays; the rest goes when room is needed, that longest
/// unused first.
#[derive(Clone, Debug)]
pub(super) struct Residency<K> {
    limit_bytes: u64,
    entries: HashMap<K, Entry>,
    /// Grows with every use.
    clock: u64,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    bytes: u64,
    used: u64,
    pins: u32,
}

/// Not even without everything that is not in use is there room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NoRoom {
    pub(super) needed_bytes: u64,
    pub(super) available_bytes: u64,
}

impl<K: Copy + Eq + Hash + Ord> Residency<K> {
    pub(super) fn new(limit_bytes: u64) -> Self {
        Self {
            limit_bytes,
            entries: HashMap::new(),
            clock: 0,
        }
    }

    /// Bytes of all that is resident.
    pub(super) fn bytes(&self) -> u64 {
        self.entries.values().map(|entry| entry.bytes).sum()
    }

    /// All that is resident, in no order.
    pub(super) fn keys(&self) -> Vec<K> {
        self.entries.keys().copied().collect()
    }

    /// Pins `key` if it is resident.
    pub(super) fn pin(&mut self, key: K) -> bool {
        self.clock += 1;
        let Some(entry) = self.entries.get_mut(&key) else {
            return false;
        };
        entry.used = self.clock;
        entry.pins += 1;
        true
    }

    /// Admits `key`, pinned once; returns what has to go for it.
    ///
    /// # Errors
    /// [`NoRoom`], and nothing has changed.
    ///
    /// # Panics
    /// If it is resident already.
    pub(super) fn admit(&mut self, key: K, bytes: u64) -> Result<Vec<K>, NoRoom> {
        assert!(!self.entries.contains_key(&key), "admitted twice");
        let pinned = self.entries.values().filter(|entry| entry.pins > 0);
        let pinned: u64 = pinned.map(|entry| entry.bytes).sum();
        let available_bytes = self.limit_bytes.saturating_sub(pinned);
        if bytes > available_bytes {
            return Err(NoRoom {
                needed_bytes: bytes,
                available_bytes,
            });
        }
        let mut gone = Vec::new();
        while self.bytes() + bytes > self.limit_bytes {
            let oldest = self.entries.iter().filter(|(_, entry)| entry.pins == 0);
            let oldest = oldest.min_by_key(|(key, entry)| (entry.used, **key));
            let key = *oldest.expect("what is not pinned makes room").0;
            self.entries.remove(&key);
            gone.push(key);
        }
        self.clock += 1;
        let used = self.clock;
        self.entries.insert(
            key,
            Entry {
                bytes,
                used,
                pins: 1,
            },
        );
        Ok(gone)
    }

    /// Takes one pin off.
    ///
    /// # Panics
    /// If `key` is not pinned.
    pub(super) fn unpin(&mut self, key: K) {
        let entry = self.entries.get_mut(&key).expect("pinned entries stay");
        entry.pins = entry.pins.checked_sub(1).expect("pinned");
    }

    /// Forgets `key` unless it is pinned; returns whether it did.
    pub(super) fn remove(&mut self, key: K) -> bool {
        let free = self.entries.get(&key).is_some_and(|entry| entry.pins == 0);
        if free {
            self.entries.remove(&key);
        }
        free
    }

    /// Forgets everything that is not pinned.
    pub(super) fn remove_unpinned(&mut self) -> Vec<K> {
        let free = self.entries.iter().filter(|(_, entry)| entry.pins == 0);
        let free: Vec<K> = free.map(|(key, _)| *key).collect();
        for key in &free {
            self.entries.remove(key);
        }
        free
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[derive(Clone, Debug)]
    enum Step {
        Use(u8),
        Release(u8),
        Drop(u8),
        DropAll,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            6 => (0u8..12).prop_map(Step::Use),
            5 => (0u8..12).prop_map(Step::Release),
            1 => (0u8..12).prop_map(Step::Drop),
            1 => Just(Step::DropAll),
        ]
    }

    fn bytes(key: u8) -> u64 {
        u64::from(key % 5) * 7 + 3
    }

    /// A list ordered by last use, with pins: slow and plain.
    #[derive(Default)]
    struct Model(Vec<(u8, u32)>);

    impl Model {
        fn total(&self, pinned: bool) -> u64 {
            let counted = self.0.iter().filter(|(_, pins)| !pinned || *pins > 0);
            counted.map(|(key, _)| bytes(*key)).sum()
        }
    }

    proptest! {
        #[test]
        fn behaves_as_a_list_ordered_by_use(steps in prop::collection::vec(step(), 1..200), limit in 10u64..90) {
            let (mut residency, mut model) = (Residency::new(limit), Model::default());
            for step in steps {
                match step {
                    Step::Use(key) => {
                        let at = model.0.iter().position(|(own, _)| *own == key);
                        prop_assert_eq!(residency.pin(key), at.is_some());
                        if let Some(at) = at {
                            let (_, pins) = model.0.remove(at);
                            model.0.push((key, pins + 1));
                            continue;
                        }
                        let available = limit.saturating_sub(model.total(true));
                        match residency.admit(key, bytes(key)) {
                            Err(refused) => {
                                prop_assert!(bytes(key) > available);
                                prop_assert_eq!(refused.available_bytes, available);
                            }
                            Ok(gone) => {
                                for key in gone {
                                    let oldest = model.0.iter().position(|(_, pins)| *pins == 0).unwrap();
                                    prop_assert_eq!(model.0.remove(oldest).0, key);
                                }
                                model.0.push((key, 1));
                            }
                        }
                    }
                    Step::Release(key) => {
                        if let Some((_, pins)) = model.0.iter_mut().find(|(own, pins)| *own == key && *pins > 0) {
                            *pins -= 1;
                            residency.unpin(key);
                        }
                    }
                    Step::Drop(key) => {
                        let at = model.0.iter().position(|(own, pins)| *own == key && *pins == 0);
                        prop_assert_eq!(residency.remove(key), at.is_some());
                        at.map(|at| model.0.remove(at));
                    }
                    Step::DropAll => {
                        let mut gone = residency.remove_unpinned();
                        gone.sort_unstable();
                        let mut free: Vec<u8> = model.0.iter().filter(|(_, pins)| *pins == 0).map(|(key, _)| *key).collect();
                        free.sort_unstable();
                        prop_assert_eq!(gone, free);
                        model.0.retain(|(_, pins)| *pins > 0);
                    }
                }
                prop_assert_eq!(residency.bytes(), model.total(false));
                prop_assert!(residency.bytes() <= limit);
            }
        }
    }

    #[test]
    fn what_is_in_use_stays_and_the_longest_unused_goes() {
        let mut residency = Residency::new(100);
        for key in [1, 2, 3] {
            assert_eq!(residency.admit(key, 30), Ok(vec![]));
        }
        residency.unpin(1);
        residency.unpin(2);
        assert!(residency.pin(1));
        residency.unpin(1);
        // 2 was used before 1; 3 is pinned.
        assert_eq!(residency.admit(4, 40), Ok(vec![2]));
        let refused = NoRoom {
            needed_bytes: 31,
            available_bytes: 30,
        };
        assert_eq!(residency.admit(5, 31), Err(refused));
        assert_eq!(residency.bytes(), 100);
    }
}
