//! Asks the links over Bluetooth and those over several paths what they have sent, and names it by topic.
use std::{collections::BTreeMap, time::Duration};

use link_lanes::usage::{Purpose, UsageReport};
use rect_core::registry::usage::{topic_of, Amount, LinkUsage, LINK, OTHER, ZENOH};
use zenoh_link_any::{status as any, ANY_LOCATOR_PREFIX as ANY};
use zenoh_link_ble::{status as ble, BLE_LOCATOR_PREFIX as BLE};

use crate::paths::method;

/// Returns what each link has sent. The links count for the time `keep` after each call. `topic` selects a single topic of the fleet,
/// `<robot>/<topic>`.
pub fn usage(fleet: &str, keep: Duration, topic: Option<&str>) -> Vec<LinkUsage> {
    let named = |link: String, path: Option<&str>, rate_per_s, report: UsageReport| {
        let counted = by_topic(fleet, report.sent);
        let path = path.map(str::to_owned);
        let mut usage = LinkUsage::of(link, path, report.window, rate_per_s, counted);
        (usage.sent).retain(|sent| topic.is_none_or(|topic| sent.topic == topic));
        usage
    };
    let over_ble = ble::usage(keep).into_iter();
    let mut links: Vec<_> = over_ble
        .map(|link| {
            let name = format!("{BLE}/{}", link.peer);
            named(name, None, link.rate_per_s, link.report)
        })
        .collect();
    links.extend(any::usage(keep).into_iter().map(|link| {
        let name = format!("{ANY}/{}", link.peer);
        named(
            name,
            Some(method(link.medium)),
            link.rate_per_s,
            link.report,
        )
    }));
    links
}

/// Adds up what was sent for each topic.
fn by_topic(
    fleet: &str,
    sent: impl IntoIterator<Item = (Purpose, link_lanes::usage::Size)>,
) -> BTreeMap<String, Amount> {
    let mut counted: BTreeMap<String, Amount> = BTreeMap::new();
    for (purpose, size) in sent {
        let topic = match purpose {
            Purpose::Key(key) => topic_of(fleet, &key),
            Purpose::Zenoh => ZENOH.to_owned(),
            Purpose::Link => LINK.to_owned(),
            Purpose::Other => OTHER.to_owned(),
        };
        let amount = counted.entry(topic).or_default();
        amount.bytes += size.bytes;
        amount.cost += size.cost;
    }
    counted
}
