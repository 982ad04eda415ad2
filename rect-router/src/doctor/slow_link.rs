//! Reports the topics that fill a slow link.
use rect_core::registry::{topics::Topics, usage::percent};

use super::Finding;

/// Returns a finding for each link of a robot that one topic fills.
pub fn findings(robot: &str, topics: &Topics) -> Vec<Finding> {
    let filled = topics.links.iter().filter_map(|link| {
        let (topic, share) = link.filled_by()?;
        let what = format!(
            "{topic} takes {} of what {} carries from {robot}, and little is free: {}",
            percent(share),
            link.name(),
            link.in_words(robot)
        );
        let advice =
            "publish it less often or smaller, or let receivers ask for less (docs/how-to/slow-link.md)";
        Some(Finding::poor("link", what, advice))
    });
    filled.collect()
}

#[cfg(test)]
mod tests {
    use rect_core::registry::usage::{LinkUsage, Sent};

    use super::*;

    #[test]
    fn the_topic_that_fills_a_link_is_named() {
        let sent = |topic: &str, bytes_per_s, share| Sent {
            topic: topic.to_owned(),
            bytes_per_s,
            share: Some(share),
        };
        let of = |camera| {
            let link = LinkUsage {
                link: "ble/laptop".to_owned(),
                path: None,
                sent: vec![
                    sent("wombat-1/camera", 30_000, camera),
                    sent("wombat-1/pose", 3_000, 0.09),
                ],
            };
            let links = vec![link];
            findings(
                "wombat-1",
                &Topics {
                    links,
                    ..Topics::default()
                },
            )
        };
        let [finding] = &of(0.83)[..] else {
            panic!("one finding is expected");
        };
        assert_eq!(
            finding.what,
            "wombat-1/camera takes 83 % of what ble/laptop carries from wombat-1, and little is free: \
             ble/laptop: camera 83 %, pose 9 %, free 8 %"
        );
        assert_eq!(of(0.61), []);
    }
}
