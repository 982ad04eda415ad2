//! Converts the connection intervals of a handshake between [`Intervals`] and the units in a hello.
use link_lanes::hello::IntervalUnits;
use zenoh_link_ble_radio::{interval::ConnectionInterval, interval_table::Intervals};

/// Returns the intervals for a hello.
pub(crate) fn to_units(intervals: &Intervals) -> IntervalUnits {
    let units = |interval: &ConnectionInterval| interval.units();
    IntervalUnits {
        requested: intervals.requested.as_ref().map(units),
        avoid: intervals.avoid.iter().map(units).collect(),
    }
}

/// Returns the intervals in a peer's hello, or `None` if one of them is not valid.
pub(crate) fn from_units(intervals: &IntervalUnits) -> Option<Intervals> {
    let requested = match intervals.requested {
        Some(units) => Some(ConnectionInterval::from_units(units)?),
        None => None,
    };
    let avoid = intervals.avoid.iter();
    Some(Intervals {
        requested,
        avoid: (avoid.map(|units| ConnectionInterval::from_units(*units)))
            .collect::<Option<_>>()?,
    })
}

#[cfg(test)]
mod tests {
    use link_lanes::hello::{INTERVAL_UNITS, MAX_INTERVALS};

    use super::*;

    #[test]
    fn every_interval_of_a_hello_is_one_of_bluetooth() {
        let of = |interval: ConnectionInterval| interval.units();
        assert_eq!(
            INTERVAL_UNITS,
            of(ConnectionInterval::MIN)..=of(ConnectionInterval::MAX)
        );
    }

    #[test]
    fn intervals_are_the_same_after_a_handshake() {
        let interval = |units| ConnectionInterval::from_units(units).expect("valid");
        let intervals = Intervals {
            requested: Some(interval(24)),
            avoid: (6..).take(MAX_INTERVALS - 1).map(interval).collect(),
        };
        assert_eq!(from_units(&to_units(&intervals)), Some(intervals));
        let none = Intervals::default();
        assert_eq!(from_units(&to_units(&none)), Some(none));
    }

    #[test]
    fn invalid_units_are_not_intervals() {
        let units = IntervalUnits {
            requested: Some(5),
            avoid: Vec::new(),
        };
        assert_eq!(from_units(&units), None);
    }
}
