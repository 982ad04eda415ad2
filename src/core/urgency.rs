//! Owns how urgent a message is, in plain words.

/// How urgent a message is. More urgent ones overtake the others, on every link and in every queue on their way.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    serde::Serialize,
    serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Urgency {
    /// It may take as long as it takes: pictures to keep, logs, files. Zenoh's `Background`.
    Bulk,
    /// What there is no reason to call otherwise. Zenoh's `Data`.
    #[default]
    Normal,
    /// It has to be there now: stop, steering. Small ones only: two dozen a second of 16 bytes are 1 kB/s of a Bluetooth
    /// link's 34. Zenoh's `InteractiveHigh`, sent at once (`express`).
    Urgent,
}

/// How Zenoh is to treat a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Zenoh's priority, 1 (`RealTime`) to 7 (`Background`).
    pub priority: u8,
    /// Sent without waiting for more to share the packet with.
    pub express: bool,
    /// Dropped where there is no room, instead of waiting for it.
    pub droppable: bool,
}

impl Urgency {
    /// For a message of which each counts.
    pub fn qos(self) -> Qos {
        let (priority, express) = match self {
            Self::Urgent => (2, true),
            Self::Normal => (5, false),
            Self::Bulk => (7, false),
        };
        Qos {
            priority,
            express,
            droppable: false,
        }
    }

    /// Whether it has a connection of its own to the router, which takes in one connection in order: where bulk waits for
    /// room on a radio, a stop command behind it on the same one would wait, too.
    pub fn goes_apart(self) -> bool {
        self != Self::Normal
    }

    /// Of a message that came at that priority of Zenoh's; a stock program may use any.
    pub fn of(priority: u8) -> Self {
        match priority {
            0..=3 => Self::Urgent,
            4..=5 => Self::Normal,
            _ => Self::Bulk,
        }
    }
}

impl Qos {
    /// For a stream's frames: the next one replaces what had no room.
    #[must_use]
    pub fn newest_wins(self) -> Self {
        Self {
            droppable: true,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_more_urgent_the_higher_zenohs_priority() {
        let all = [Urgency::Urgent, Urgency::Normal, Urgency::Bulk].map(|u| u.qos().priority);
        assert!(all.is_sorted(), "{all:?}");
        assert!(all.iter().all(|p| (1..=7).contains(p)));
        for urgency in [Urgency::Urgent, Urgency::Normal, Urgency::Bulk] {
            assert_eq!(Urgency::of(urgency.qos().priority), urgency);
        }
        assert!(Urgency::Normal.qos().newest_wins().droppable);
    }
}
