//! Defines how a router reports what its slow links send, by topic, and describes it in words.
use std::{collections::BTreeMap, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{
    name::key::OWN,
    text::{display, humanize},
};

/// Zenoh's own messages: declarations and keep-alives.
pub const ZENOH: &str = "zenoh";
/// Messages of the link itself: acknowledgements.
pub const LINK: &str = "link";
/// Everything else.
pub const OTHER: &str = "other";

/// The part after `@rect/` of the keys of messages for robots that have asked for fewer (`message::throttled`).
const THROTTLED: &str = "throttled";
/// The largest number of rows of a link; the others are added up in [`OTHER`].
const MAX_ROWS: usize = 32;
/// The share of a link from which on it is busy, and the share of a topic from which on that topic fills the link.
const BUSY: f64 = 0.85;
const FILLS: f64 = 0.5;
/// The smallest share that the line about a link mentions.
const MENTIONED: f64 = 0.01;

/// The bytes that a link has sent within the last seconds, by topic.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkUsage {
    /// The method and the peer of the link, such as `ble/laptop`.
    pub link: String,
    /// The method of the path, if the link has several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<String>,
    /// The topics for which it has sent something, most bytes first.
    pub sent: Vec<Sent>,
}

/// The bytes that a link has sent for one topic. In JSON it is an array of the fields in this order, without a share that is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Row", into = "Row")]
pub struct Sent {
    /// The robot and the topic, `wombat-1/camera`; for the internal keys of RECT their beginning, and for keys outside of the fleet the
    /// key after a slash. Or [`ZENOH`], [`LINK`] or [`OTHER`].
    pub topic: String,
    /// Bytes per second, with everything that Zenoh and the link add.
    pub bytes_per_s: u64,
    /// The share of what the link carries, from 0 to 1, if that was measured.
    pub share: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Row {
    Measured(String, u64, f64),
    Unmeasured(String, u64),
}

impl From<Row> for Sent {
    fn from(row: Row) -> Self {
        let (topic, bytes_per_s, share) = match row {
            Row::Measured(topic, bytes, share) => (topic, bytes, Some(share)),
            Row::Unmeasured(topic, bytes) => (topic, bytes, None),
        };
        Self {
            topic,
            bytes_per_s,
            share,
        }
    }
}

impl From<Sent> for Row {
    fn from(sent: Sent) -> Self {
        let Sent {
            topic,
            bytes_per_s: bytes,
            share,
        } = sent;
        match share {
            Some(share) => Self::Measured(topic, bytes, share),
            None => Self::Unmeasured(topic, bytes),
        }
    }
}

/// Bytes that a link has sent, and the part of its rate that they take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Amount {
    /// Number of bytes.
    pub bytes: u64,
    /// The part of the rate, in the unit of the rate.
    pub cost: u64,
}

impl LinkUsage {
    /// Creates a report from what was counted within `window`, by topic. `rate_per_s` is what the link carries, if that was measured.
    pub fn of(
        link: String,
        path: Option<String>,
        window: Duration,
        rate_per_s: Option<f64>,
        counted: BTreeMap<String, Amount>,
    ) -> Self {
        // Over less, the rate would be that of a single message.
        let seconds = window.as_secs_f64().max(0.5);
        let rate_per_s = rate_per_s.filter(|rate| *rate > 0.0);
        let sent = counted.into_iter().map(|(topic, amount)| Sent {
            topic,
            bytes_per_s: (amount.bytes as f64 / seconds).round() as u64,
            share: rate_per_s.map(|rate| thousandths(amount.cost as f64 / seconds / rate)),
        });
        let mut sent: Vec<_> = sent.collect();
        let by_bytes = |one: &Sent, other: &Sent| other.bytes_per_s.cmp(&one.bytes_per_s);
        sent.sort_by(by_bytes);
        if sent.len() > MAX_ROWS {
            let (mut others, mut named): (Vec<_>, Vec<_>) =
                sent.into_iter().partition(|row| row.topic == OTHER);
            others.extend(named.drain(MAX_ROWS - 1..));
            let share: f64 = others.iter().filter_map(|row| row.share).sum();
            named.push(Sent {
                topic: OTHER.to_owned(),
                bytes_per_s: others.iter().map(|row| row.bytes_per_s).sum(),
                share: rate_per_s.map(|_| thousandths(share)),
            });
            named.sort_by(by_bytes);
            sent = named;
        }
        Self { link, path, sent }
    }

    /// Returns whether the link is slow: all or a part of it is Bluetooth, and this part is meant.
    pub fn is_slow(&self) -> bool {
        self.path
            .as_deref()
            .unwrap_or(&self.link)
            .starts_with("ble")
    }

    /// Returns the share of the link that is used, if it is known.
    pub fn used(&self) -> Option<f64> {
        let shares = self.sent.iter().map(|row| row.share);
        shares.sum()
    }

    /// Returns the topic that fills the link, and its share: more than half of a link that is busy.
    pub fn filled_by(&self) -> Option<(&str, f64)> {
        let first = self.sent.iter().max_by_key(|row| row.bytes_per_s)?;
        let share = first.share.filter(|share| *share > FILLS)?;
        (self.used()? > BUSY).then_some((&first.topic, share))
    }

    /// Returns what was sent for one topic, `wombat-1/camera`.
    pub fn topic(&self, topic: &str) -> Option<&Sent> {
        self.sent.iter().find(|row| row.topic == topic)
    }

    /// Describes the use of the link: `ble/laptop: camera 61 %, pose 9 %, free 24 %`. The topics of `robot` are named without it.
    pub fn in_words(&self, robot: &str) -> String {
        let name = |topic: &str| {
            let own = topic.strip_prefix(robot);
            let own = own.and_then(|topic| topic.strip_prefix('/'));
            display::line(own.unwrap_or(topic)).into_owned()
        };
        let mut parts: Vec<_> = match self.used() {
            Some(used) if !self.sent.is_empty() => {
                let shares = self.sent.iter().filter_map(|row| Some((row, row.share?)));
                let mentioned = shares.filter(|(_, share)| *share >= MENTIONED);
                let mut parts: Vec<_> = mentioned
                    .map(|(row, share)| format!("{} {}", name(&row.topic), percent(share)))
                    .collect();
                parts.push(format!("free {}", percent((1.0 - used).max(0.0))));
                parts
            }
            _ => {
                let rows = self.sent.iter();
                rows.map(|row| {
                    format!(
                        "{} {}/s",
                        name(&row.topic),
                        humanize::bytes(row.bytes_per_s)
                    )
                })
                .collect()
            }
        };
        if parts.is_empty() {
            parts.push("nothing was sent".to_owned());
        }
        format!("{}: {}", self.name(), parts.join(", "))
    }

    /// Returns the name of the link, with its path if it has several.
    pub fn name(&self) -> String {
        let link = display::line(&self.link);
        match &self.path {
            Some(path) => format!("{link} ({})", display::line(path)),
            None => link.into_owned(),
        }
    }
}

/// Returns the bytes per second that all these links have sent for a topic, `wombat-1/camera`.
pub fn on_air<'a>(links: impl IntoIterator<Item = &'a LinkUsage>, topic: &str) -> u64 {
    let of_topic = links.into_iter().filter_map(|link| link.topic(topic));
    of_topic.map(|row| row.bytes_per_s).sum()
}

/// Returns the name under which the messages of a key count: see [`Sent::topic`].
pub fn topic_of(fleet: &str, key: &str) -> String {
    let below = key
        .strip_prefix(fleet)
        .and_then(|key| key.strip_prefix('/'));
    let Some(below) = below.filter(|below| below.contains('/')) else {
        return format!("/{key}");
    };
    let parts: Vec<_> = below.splitn(5, '/').collect();
    match parts[..] {
        // The messages for a robot that has asked for fewer of a topic.
        [robot, OWN, THROTTLED, _, topic] => format!("{robot}/{topic}"),
        [robot, OWN, part, ..] => format!("{robot}/{OWN}/{part}"),
        _ => below.to_owned(),
    }
}

/// Writes a share in percent.
pub fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn thousandths(number: f64) -> f64 {
    (number * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        message::throttled,
        name::{key::KeySpace, Name},
    };

    fn usage(rate_per_s: Option<f64>, counted: &[(&str, u64)]) -> LinkUsage {
        let counted = counted.iter().map(|(topic, bytes)| {
            let amount = Amount {
                bytes: *bytes,
                cost: bytes + 100,
            };
            ((*topic).to_owned(), amount)
        });
        let window = Duration::from_secs(5);
        LinkUsage::of(
            "ble/laptop".to_owned(),
            None,
            window,
            rate_per_s,
            counted.collect(),
        )
    }

    #[test]
    fn the_shares_of_a_link_are_named_and_what_is_free() {
        let one = usage(
            Some(34_000.0),
            &[
                ("wombat-1/pose", 15_300),
                ("wombat-1/camera", 103_700),
                ("wombat-3/map", 9_700),
                ("zenoh", 500),
            ],
        );
        assert_eq!(
            one.in_words("wombat-1"),
            "ble/laptop: camera 61 %, pose 9 %, wombat-3/map 6 %, free 24 %"
        );
        assert_eq!(one.filled_by(), None, "it is not busy");
        let json = serde_json::to_value(&one).expect("serializable");
        assert_eq!(
            json["sent"][0],
            serde_json::json!(["wombat-1/camera", 20_740, 0.611])
        );
        assert_eq!(
            serde_json::from_value::<LinkUsage>(json).expect("readable"),
            one
        );
    }

    #[test]
    fn without_a_measured_rate_bytes_are_named() {
        let one = usage(None, &[("wombat-1/pose", 15_300)]);
        assert_eq!(one.in_words("wombat-1"), "ble/laptop: pose 3060 B/s");
        assert_eq!(one.filled_by(), None);
        let json = serde_json::to_value(&one).expect("serializable");
        assert_eq!(json["sent"][0], serde_json::json!(["wombat-1/pose", 3060]));
        assert_eq!(
            usage(None, &[]).in_words("wombat-1"),
            "ble/laptop: nothing was sent"
        );
        let path = Some("ble".to_owned());
        let of_two = LinkUsage {
            path,
            ..usage(None, &[])
        };
        assert_eq!(of_two.name(), "ble/laptop (ble)");
    }

    #[test]
    fn a_topic_that_takes_most_of_a_busy_link_fills_it() {
        let busy = usage(
            Some(34_000.0),
            &[("wombat-1/camera", 145_000), ("wombat-1/pose", 15_000)],
        );
        let (topic, share) = busy.filled_by().expect("it is filled");
        assert_eq!(
            (topic, percent(share).as_str()),
            ("wombat-1/camera", "85 %")
        );
        let shared = usage(Some(34_000.0), &[("a/x", 80_000), ("a/y", 80_000)]);
        assert_eq!(shared.filled_by(), None);
    }

    #[test]
    fn rows_beyond_the_limit_are_added_up() {
        let topics: Vec<_> = (0..100).map(|n| format!("wombat-1/t{n}")).collect();
        let mut counted: Vec<_> = topics.iter().map(|topic| (topic.as_str(), 1000)).collect();
        counted.push((OTHER, 5000));
        let one = usage(Some(34_000.0), &counted);
        assert!(one.sent.len() <= MAX_ROWS);
        let total: u64 = one.sent.iter().map(|row| row.bytes_per_s).sum();
        assert_eq!(total, 105_000 / 5);
        assert_eq!(one.sent.iter().filter(|row| row.topic == OTHER).count(), 1);
    }

    #[test]
    fn keys_are_named_below_the_fleet() {
        for (key, topic) in [
            ("rect/wombat-1/camera", "wombat-1/camera"),
            (
                "rect/wombat-1/to/wombat-2/mode",
                "wombat-1/to/wombat-2/mode",
            ),
            ("rect/wombat-1/@rect/topics", "wombat-1/@rect/topics"),
            ("rect/wombat-1/@rect/@log/info/arm", "wombat-1/@rect/@log"),
            ("rect/wombat-1", "/rect/wombat-1"),
            ("rectangle/x/y", "/rectangle/x/y"),
        ] {
            assert_eq!(topic_of("rect", key), topic);
        }
        let name = |text| Name::new(text).expect("valid name");
        let place = KeySpace {
            fleet: name("rect"),
            robot: name("wombat-1"),
        };
        let key = throttled::publication(&place, &name("laptop"), "arm/angle");
        assert_eq!(topic_of("rect", &key), "wombat-1/arm/angle");
    }
}
