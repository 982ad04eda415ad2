//! The values that survive a restart of the router, as they are on its disk.
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::page::{read, write};
use crate::message::retained::value::Value;

/// The beginning of 2020, in milliseconds since 1970. A clock that shows an earlier time was not set.
const EARLIEST_MS: u64 = 1_577_836_800_000;

/// The values on disk, with the ages that they had when they were written.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Saved {
    /// The run of the router that has written them.
    #[serde(rename = "r")]
    pub run: u32,
    /// When they were written, in milliseconds since 1970 by the computer's clock. Earlier versions did not write that.
    #[serde(rename = "t", default)]
    pub at_ms: u64,
    /// The values.
    #[serde(rename = "v")]
    pub records: Vec<Value>,
}

impl Saved {
    /// Reads what [`encode`](Self::encode) returned, at that time of day. The ages include the time since the values were written; if the
    /// clock was set back meanwhile, or was not set, they are the least that is known.
    ///
    /// # Errors
    /// Returns the reason why the bytes are not that.
    pub(super) fn decode(bytes: &[u8], now_ms: u64) -> Result<Self, String> {
        let mut saved: Self = read(bytes)?;
        let ago_ms = match saved.at_ms {
            0..EARLIEST_MS => 0,
            at_ms => now_ms.saturating_sub(at_ms),
        };
        for value in &mut saved.records {
            value.age = value.age.saturating_add(Duration::from_millis(ago_ms));
        }
        Ok(saved)
    }

    /// Returns the bytes for the disk.
    pub(super) fn encode(&self) -> Vec<u8> {
        write(self).bytes.to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{message::retained::value::tests::value, state::page::Page};

    /// A time of day in 2026.
    const NOW_MS: u64 = 1_795_000_000_000;

    #[test]
    fn ages_include_the_time_since_unless_the_clock_is_wrong() {
        let of_value = value().age.as_millis() as u64;
        for (at_ms, now_ms, ago_ms) in [
            (NOW_MS, NOW_MS + 3_600_000, 3_600_000),
            (NOW_MS, NOW_MS, 0),
            (NOW_MS, NOW_MS - 3_600_000, 0),
            (NOW_MS, 0, 0),
            (5000, NOW_MS, 0),
            (u64::MAX, NOW_MS, 0),
            (NOW_MS, u64::MAX, u64::MAX - NOW_MS),
        ] {
            let saved = Saved {
                run: 7,
                at_ms,
                records: vec![value()],
            };
            let loaded = Saved::decode(&saved.encode(), now_ms).expect("saved");
            let age = Duration::from_millis(of_value) + Duration::from_millis(ago_ms);
            assert_eq!(loaded.records[0].age, age, "{at_ms} {now_ms}");
        }
    }

    #[test]
    fn files_of_earlier_versions_are_read() {
        let page = Page {
            run: 7,
            records: vec![value()],
            ..Page::default()
        };
        let loaded = Saved::decode(&write(&page).bytes, NOW_MS).expect("saved");
        assert_eq!((loaded.run, loaded.records), (7, vec![value()]));
    }
}
