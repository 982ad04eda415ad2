//! Remembers which tokens end while they are asked for.
//!
//! Replies and samples arrive on different threads. On a busy computer, a reply that lists a token can be processed after the end of the
//! token, which nothing would announce again.
use std::collections::BTreeSet;

/// The tokens that have ended since the question that is under way was sent.
#[derive(Debug, Default)]
pub struct EndedTokens(Option<BTreeSet<String>>);

impl EndedTokens {
    /// Handles that the tokens are asked for.
    pub fn on_asked(&mut self) {
        self.0 = Some(BTreeSet::new());
    }

    /// Handles that no more replies follow.
    pub fn on_answered(&mut self) {
        self.0 = None;
    }

    /// Handles a sample of the subscriber: a token has appeared or ended.
    pub fn on_sample(&mut self, key: &str, is_deleted: bool) {
        let Some(ended) = &mut self.0 else { return };
        if is_deleted {
            ended.insert(key.to_owned());
        } else {
            ended.remove(key);
        }
    }

    /// Returns whether a reply lists a token that has ended.
    pub fn contains(&self, key: &str) -> bool {
        self.0.as_ref().is_some_and(|ended| ended.contains(key))
    }
}
