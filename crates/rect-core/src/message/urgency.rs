//! Defines the urgency of messages, and its translation into Zenoh's quality of service.

/// The urgency of a message. More urgent messages overtake less urgent ones on every link and in every queue.
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
    /// For data that may take any time: pictures to keep, logs, files. Zenoh's `Background`.
    Bulk,
    /// The default. Zenoh's `Data`.
    #[default]
    Normal,
    /// For messages that must arrive immediately, such as stop and steering. Keep them small and rare: 24 messages of
    /// 16 bytes per second take 1 kB/s of the 34 kB/s of a Bluetooth link. Zenoh's `InteractiveHigh`, sent without
    /// batching (`express`).
    Urgent,
}

/// Zenoh's quality of service for a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Zenoh's priority, 1 (`RealTime`) to 7 (`Background`).
    pub priority: u8,
    /// Whether the message is sent without waiting for others that could share its packet.
    pub express: bool,
    /// Whether the message is dropped, instead of waiting, if a queue is full.
    pub droppable: bool,
}

impl Qos {
    /// The quality of service of a question to a registry and of its answer, which overtake messages that are not urgent: a team
    /// asks when its robots are busy.
    pub const REGISTRY: Self = Self {
        priority: 4,
        express: false,
        droppable: false,
    };
}

impl Urgency {
    /// Returns the quality of service of a message that must not be dropped.
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

    /// Returns whether messages of this urgency use a Zenoh session of their own with the router. The router reads each
    /// session in order: if a bulk message waits for room on a radio link, a stop command behind it on the same session
    /// would wait too.
    pub fn uses_separate_session(self) -> bool {
        self != Self::Normal
    }

    /// Returns the urgency of a message that arrived with a priority of Zenoh. Other Zenoh programs may use any
    /// priority. Routers send large normal messages with `DataLow` (`qos/network` in `config/robot.json5`).
    pub fn from_priority(priority: u8) -> Self {
        match priority {
            0..=3 => Self::Urgent,
            4..=6 => Self::Normal,
            _ => Self::Bulk,
        }
    }
}

impl Qos {
    /// Makes the message droppable, for the frames of a stream: the next frame replaces one for which there was no
    /// room.
    #[must_use]
    pub fn drop_when_congested(self) -> Self {
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
    fn urgencies_map_to_zenohs_priorities_in_order() {
        let all = [Urgency::Urgent, Urgency::Normal, Urgency::Bulk].map(|u| u.qos().priority);
        assert!(all.is_sorted(), "{all:?}");
        assert!(all.iter().all(|p| (1..=7).contains(p)));
        for urgency in [Urgency::Urgent, Urgency::Normal, Urgency::Bulk] {
            assert_eq!(Urgency::from_priority(urgency.qos().priority), urgency);
        }
        assert_eq!(Urgency::from_priority(6), Urgency::Normal);
        assert!(Urgency::Normal.qos().drop_when_congested().droppable);
    }
}
