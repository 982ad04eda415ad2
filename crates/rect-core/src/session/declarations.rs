//! Keeps what a program has declared for its calls: publishers, and queriers for requests.
use std::{collections::HashMap, hash::Hash, sync::Arc};

/// The declarations of a program for its calls, each by what identifies it.
#[derive(Debug)]
pub struct Declarations<K, D>(HashMap<K, Arc<D>>);

/// The maximum number of declarations that are kept. Adding one more ends all others; they are declared again on use.
pub const MAX: usize = 256;

impl<K: Eq + Hash, D> Declarations<K, D> {
    /// Returns the declaration of a key.
    pub fn get(&self, key: &K) -> Option<&Arc<D>> {
        self.0.get(key)
    }

    /// Adds a declaration. Returns those that are not kept any more; dropping them may block.
    #[must_use]
    pub fn add(&mut self, key: K, declared: Arc<D>) -> Vec<Arc<D>> {
        let is_full = self.0.len() >= MAX && !self.0.contains_key(&key);
        let mut removed = Vec::new();
        if is_full {
            removed.extend(self.0.drain().map(|(_, declared)| declared));
        }
        removed.extend(self.0.insert(key, declared));
        removed
    }
}

impl<K, D> Default for Declarations<K, D> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_more_than_the_maximum_ends_all_others() {
        let mut declared = Declarations::default();
        for key in 0..MAX {
            assert!(declared.add(key, Arc::new(key)).is_empty());
        }
        assert_eq!(declared.add(MAX, Arc::new(7)).len(), MAX);
        assert_eq!(declared.get(&0), None);
        assert_eq!(declared.get(&MAX).map(|last| **last), Some(7));
    }
}
