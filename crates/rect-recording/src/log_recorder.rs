//! Decides which logs are recorded, and drives their reading.
use std::{collections::BTreeSet, convert::Infallible, sync::Arc, time::Instant};

use rect_core::{
    driver::{Driver, Event, Reaction, Step},
    log::reader::{Item, LogReader, Reading},
    name::{key::KeySpace, topic::Pattern, Name},
};

use crate::recorder::Recorder;

/// Reads the new lines of a robot, or of all robots, and records them. Private lines are left out.
pub struct LogRecorder {
    reader: LogReader,
    recorder: Arc<Recorder>,
}

impl LogRecorder {
    /// Returns the drivers for a recording by a program of the robot of `place`: one for each robot that the patterns name, or a single
    /// one for all robots. Without patterns, one for the robot itself.
    pub fn of_recording(
        place: &KeySpace,
        patterns: &[Pattern],
        recorder: &Arc<Recorder>,
    ) -> Vec<Self> {
        let robots = robots(&place.robot, patterns).into_iter();
        let drivers = robots.map(|robot| {
            let reading = Reading {
                robot,
                last: 0,
                follow: true,
                without_private: true,
                ..Reading::default()
            };
            Self {
                reader: LogReader::new(place.clone(), reading),
                recorder: recorder.clone(),
            }
        });
        drivers.collect()
    }

    fn record(&self, item: Item) {
        match item {
            Item::Lines { robot, lines, .. } => {
                for kept in &lines {
                    self.recorder.on_line(&robot, kept);
                }
            }
            Item::Missed(robot) => self.recorder.on_missed_lines(&robot),
            Item::Complete => {}
        }
    }
}

/// Returns the robots whose lines are recorded; `None` stands for all robots.
fn robots(own: &Name, patterns: &[Pattern]) -> BTreeSet<Option<Name>> {
    if patterns.is_empty() {
        return BTreeSet::from([Some(own.clone())]);
    }
    let robots: BTreeSet<_> = patterns.iter().map(|one| one.robot().cloned()).collect();
    match robots.contains(&None) {
        true => BTreeSet::from([None]),
        false => robots,
    }
}

impl Driver for LogRecorder {
    type Item = Infallible;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Infallible> {
        let Reaction { items, polls } = self.reader.on_event(now, event);
        for item in items {
            self.record(item);
        }
        let items = Vec::new();
        Reaction { items, polls }
    }

    fn poll(&mut self, now: Instant) -> Step<Infallible, ()> {
        loop {
            match self.reader.poll(now) {
                Step::Deliver(item) => self.record(item),
                Step::Act(action) => return Step::Act(action),
                Step::Wait(until) => return Step::Wait(until),
                Step::Finished(()) => return Step::Finished(()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selected(patterns: &[&str]) -> Vec<String> {
        let own = Name::new("wombat-1").expect("a name");
        let patterns = patterns.iter().map(|one| one.parse().expect("a pattern"));
        let robots = robots(&own, &patterns.collect::<Vec<_>>()).into_iter();
        let names = robots.map(|robot| robot.map_or("*".to_owned(), |name| name.to_string()));
        names.collect()
    }

    #[test]
    fn the_logs_of_the_recorded_robots_are_read_each_one_once() {
        assert_eq!(selected(&[]), ["wombat-1"]);
        assert_eq!(
            selected(&["wombat-3/arm/*", "wombat-2/**", "wombat-3/stop"]),
            ["wombat-2", "wombat-3"]
        );
        assert_eq!(selected(&["wombat-2/**", "*/stop"]), ["*"]);
    }
}
