//! Determines for how long nothing was received over a link. Zenoh sends something over each link at least every 2.5 s (a quarter of the
//! lease of a session, 10 s), so that a link over which nothing arrives for longer is silent: nothing has to be sent to find that out.
use std::{
    collections::{HashMap, HashSet},
    time::{Duration, Instant},
};

use parking_lot::Mutex;

use crate::connections::LinkEnds;

/// How long nothing arrives until a link counts as silent: the time between two messages of Zenoh, and a second for a slow radio.
const SILENT_AFTER: Duration = Duration::from_millis(3500);

/// The bytes received over each link at the last look, and since when they are the same.
#[derive(Default)]
pub struct Silence(Mutex<HashMap<LinkEnds, (u64, Instant)>>);

impl Silence {
    /// Records that `received_bytes` were received over a link until `now`. Returns for how long it has been silent; `None` if it is not.
    pub fn of(&self, link: LinkEnds, received_bytes: u64, now: Instant) -> Option<Duration> {
        let mut links = self.0.lock();
        let (before, since) = links.entry(link).or_insert((received_bytes, now));
        if *before != received_bytes {
            (*before, *since) = (received_bytes, now);
        }
        let silent = now.saturating_duration_since(*since);
        Some(silent).filter(|silent| *silent >= SILENT_AFTER)
    }

    /// Forgets all links but these.
    pub fn retain(&self, open: &HashSet<LinkEnds>) {
        self.0.lock().retain(|link, _| open.contains(link));
    }
}

#[cfg(test)]
mod tests {
    use zenoh_config::EndPoint;

    use super::*;

    fn link(peer: &str) -> LinkEnds {
        let end = |text: &str| text.parse::<EndPoint>().expect("an endpoint").to_locator();
        LinkEnds::of(&end("any/wombat-1"), &end(&format!("any/{peer}")))
    }

    #[test]
    fn a_link_is_silent_while_nothing_arrives() {
        let (silence, start) = (Silence::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        let of = |bytes, ms| silence.of(link("wombat-2"), bytes, at(ms));
        assert_eq!(of(10, 0), None);
        // Zenoh's message of an idle link.
        assert_eq!((of(10, 2500), of(14, 2600)), (None, None));
        assert_eq!(of(14, 6000), None);
        assert_eq!(of(14, 6100), Some(Duration::from_millis(3500)));
        assert_eq!(silence.of(link("wombat-3"), 14, at(6100)), None);
        assert_eq!(of(14, 9100), Some(Duration::from_millis(6500)));
        assert_eq!(of(15, 9200), None);
    }

    #[test]
    fn a_link_that_is_opened_again_begins_anew() {
        let (silence, start) = (Silence::default(), Instant::now());
        assert_eq!(silence.of(link("wombat-2"), 10, start), None);
        silence.retain(&HashSet::new());
        let later = start + Duration::from_secs(60);
        assert_eq!(silence.of(link("wombat-2"), 10, later), None);
    }
}
