//! Decides which values that do not fit their type a program warns of.
use std::collections::HashSet;

use crate::name::{topic::Topic, Name};

/// For how many topics of senders a warning is remembered. There is none for further ones.
const MAX_WARNED: usize = 1000;

/// The warnings of one program: one for each sender and topic.
#[derive(Debug, Default)]
pub struct Problems {
    warned: HashSet<(Name, Topic)>,
}

impl Problems {
    /// Handles a message or request whose value does not fit. Returns the text of the warning, if there is to be one.
    pub fn on_problem(
        &mut self,
        sender: &Name,
        topic: &Topic,
        problem: &dyn std::fmt::Display,
    ) -> Option<String> {
        let is_full = self.warned.len() >= MAX_WARNED;
        let is_first = !is_full && self.warned.insert((sender.clone(), topic.clone()));
        is_first.then(|| format!("{topic} of {sender}: {problem}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warns_once_of_each_sender_and_topic() {
        let mut problems = Problems::default();
        let mut warning = |sender: &str, topic: &str| {
            let (sender, topic) = (Name::new(sender).unwrap(), Topic::new(topic).unwrap());
            problems.on_problem(&sender, &topic, &"expected a number, found text")
        };
        let text = "battery of wombat-2: expected a number, found text";
        assert_eq!(warning("wombat-2", "battery").as_deref(), Some(text));
        assert_eq!(warning("wombat-2", "battery"), None);
        assert!(warning("wombat-2", "arm").is_some());
        assert!(warning("wombat-3", "battery").is_some());
        let warnings =
            (0..2 * MAX_WARNED).filter(|n| warning("wombat-4", &format!("t{n}")).is_some());
        assert_eq!(warnings.count(), MAX_WARNED - 3);
    }
}
