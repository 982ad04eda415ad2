//! Derives what to expect from theory and the simulated air, and names what deviates from it.
use serde_json::{json, Value};
use zenoh_link_ble_air::{LlPayload, Phy};

use super::{
    document::{Place, RoundTripSummary, Survey},
    BLE,
};

/// The survey of the simulated air: `make survey-sim`.
const SIMULATED: &str = include_str!("../../../../surveys/simulated-air.json");
/// Bytes that Zenoh, the link and L2CAP add to a message with the secret of a team (benches/results/on_air.md).
const OVERHEAD_BYTES: usize = 18 + 6;
/// Sizes for which the curves of theory are drawn, in bytes.
const SIZES: [usize; 10] = [20, 50, 100, 200, 500, 1000, 2000, 4000, 8000, 16_000];

/// Goodput at short distance below this share of the one with short packets deviates.
const ENOUGH: f64 = 0.7;
/// A round trip at short distance above this is longer than two connection intervals of 50 ms, BlueZ's default.
const LONG_ROUND_TRIP_MS: f64 = 110.0;
/// How much a load may delay urgent messages.
const URGENT_DELAY_MS: f64 = 100.0;
/// A signal weaker than free space by more than this deviates: antennas and bodies take up to 20 dB.
const WEAKER_DB: f64 = 25.0;
const DISCOVERED_WITHIN_S: f64 = 2.0;
/// The supervision timeout of `config/bluetooth.conf`, and the time to notice it.
const NOTICED_WITHIN_S: f64 = 5.0;
/// A link with the method `any` keeps messages until a path returns, or until Zenoh's lease of 10 s has expired.
const ANY_NOTICED_WITHIN_S: f64 = 20.0;
const REACHABLE_WITHIN_S: f64 = 5.0;
const SWITCHED_WITHIN_MS: f64 = 1000.0;
/// A place counts as near up to this distance.
const NEAR_M: f64 = 2.0;

/// Returns the goodput of a link that sends without a pause or an error, in kB/s of payload.
fn goodput(bytes: usize, phy: Phy, payload: LlPayload) -> f64 {
    let on_air = bytes + OVERHEAD_BYTES;
    let full = on_air / payload.bytes();
    let rest = on_air % payload.bytes();
    let mut seconds = phy.exchange(payload.bytes(), 0).as_secs_f64() * full as f64;
    if rest > 0 {
        seconds += phy.exchange(rest, 0).as_secs_f64();
    }
    bytes as f64 / 1000.0 / seconds
}

/// Returns the signal in free space at this distance, for a radio that sends at 0 dBm, in dBm (docs/how-to/distance.md).
fn free_space_dbm(distance_m: f64) -> f64 {
    -(40.2 + 20.0 * distance_m.log10())
}

/// Radios whose goodput is known from the specification.
const RADIOS: [(&str, Phy, LlPayload); 3] = [
    (
        "2M PHY, packets of 251 bytes",
        Phy::Le2M,
        LlPayload::Bytes251,
    ),
    (
        "1M PHY, packets of 251 bytes",
        Phy::Le1M,
        LlPayload::Bytes251,
    ),
    ("1M PHY, packets of 27 bytes", Phy::Le1M, LlPayload::Bytes27),
];
/// How far the goodput may be from that of a radio that it resembles, as a factor.
const SIMILAR: f64 = 1.6;

/// Returns the radio whose goodput is the nearest one to that of a near place, if one is near enough.
pub fn resembles(place: &Place) -> Option<&'static str> {
    if !is_near(place) {
        return None;
    }
    let load = place.sent.last()?;
    let distance = |(_, phy, payload): &(&str, Phy, LlPayload)| {
        (load.kb_per_s / goodput(load.bytes, *phy, *payload))
            .ln()
            .abs()
    };
    let nearest = RADIOS
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    (distance(nearest) <= SIMILAR.ln()).then_some(nearest.0)
}

/// Returns whether the link at a place is one over Bluetooth with nearly no losses.
fn is_near(place: &Place) -> bool {
    let is_near = place.distance_m.is_none_or(|m| m <= NEAR_M) && !place.behind_body;
    is_near && place.path.as_deref() == Some(BLE)
}

/// Returns the curves beside which the page draws the measurements.
pub fn curves() -> serde_json::Result<Value> {
    let theory = RADIOS.map(|(name, phy, payload)| {
        let points = SIZES.map(|bytes| [bytes as f64, goodput(bytes, phy, payload)]);
        json!({ "name": name, "points": points })
    });
    let distances = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0];
    Ok(json!({
        "goodput": theory,
        "free_space": distances.map(|m| [m, free_space_dbm(m)]),
        "simulated": serde_json::from_str::<Value>(SIMULATED)?,
    }))
}

/// Returns what deviates, in words.
pub fn deviations(survey: &Survey) -> Vec<String> {
    let mut found = Vec::new();
    let noticed_within_s = match survey.link.method.as_str() {
        "any" => ANY_NOTICED_WITHIN_S,
        _ => NOTICED_WITHIN_S,
    };
    for reconnection in &survey.reconnections {
        if reconnection.noticed_s > noticed_within_s {
            found.push(format!(
                "The loss of the link was noticed after {:.1} s, expected {noticed_within_s} s: is the supervision timeout set (`rect doctor`)?",
                reconnection.noticed_s
            ));
        }
        if reconnection.reachable_s > REACHABLE_WITHIN_S {
            found.push(format!(
                "The robots reached each other {:.1} s after the radio was back, expected {REACHABLE_WITHIN_S} s.",
                reconnection.reachable_s
            ));
        }
    }
    for place in &survey.places {
        of_place(place, &mut found);
    }
    for switch in &survey.switches {
        let longest = switch.longest_round_trip_ms.unwrap_or(f64::INFINITY);
        if longest > SWITCHED_WITHIN_MS {
            found.push(format!(
                "While the link switched to {}, a request took {longest:.0} ms, expected {SWITCHED_WITHIN_MS} ms.",
                switch.path
            ));
        }
        if switch.lost > 0 {
            found.push(format!(
                "Lost messages while the link switched to {1}: {0}.",
                switch.lost, switch.path
            ));
        }
    }
    if let Some(soak) = survey.soak.as_ref().filter(|soak| soak.round_trip.lost > 0) {
        found.push(format!(
            "{} of {} requests were lost within {:.0} s.",
            soak.round_trip.lost,
            soak.round_trip.lost + soak.round_trip.replies,
            soak.seconds
        ));
    }
    found
}

fn of_place(place: &Place, found: &mut Vec<String>) {
    let label = &place.label;
    if let Some(error) = &place.error {
        found.push(format!("{label}: nothing was measured: {error}"));
        return;
    }
    if place.lost() > 0 {
        found.push(format!("{label}: lost messages: {}.", place.lost()));
    }
    if let Some(discovery) = &place.discovery {
        let error = discovery.error.as_ref();
        found.extend(
            error.map(|error| format!("{label}: the other robot was not discovered: {error}")),
        );
        let slowest = discovery.seconds.iter().copied().reduce(f64::max);
        if let Some(slowest) = slowest.filter(|s| *s > DISCOVERED_WITHIN_S) {
            found.push(format!(
                "{label}: the other robot was discovered after {slowest:.1} s at the latest, expected {DISCOVERED_WITHIN_S} s."
            ));
        }
    }
    let p50 = |of: &Option<RoundTripSummary>| of.as_ref()?.quantile_ms(0.5);
    let p99 = |of: &Option<RoundTripSummary>| of.as_ref()?.quantile_ms(0.99);
    if let (Some(idle), Some(loaded)) = (p99(&place.round_trip), p99(&place.round_trip_under_load))
    {
        if loaded > idle + URGENT_DELAY_MS {
            found.push(format!(
                "{label}: a load delays urgent messages: round trip p99 {loaded:.0} ms, idle {idle:.0} ms."
            ));
        }
    }
    if let (Some(signal), Some(distance)) = (place.signal_dbm(), place.distance_m) {
        let expected = free_space_dbm(distance);
        if f64::from(signal) < expected - WEAKER_DB {
            found.push(format!(
                "{label}: the signal of {signal} dBm is much weaker than in free space ({expected:.0} dBm): see docs/how-to/distance.md."
            ));
        }
    }
    if !is_near(place) {
        return;
    }
    if let Some(ms) = p50(&place.round_trip).filter(|ms| *ms > LONG_ROUND_TRIP_MS) {
        found.push(format!(
            "{label}: the round trip of {ms:.0} ms suggests a connection interval of {:.0} ms: is it set (`rect doctor`)?",
            ms / 2.0
        ));
    }
    for load in place.sent.iter().chain(&place.received) {
        let least = ENOUGH * goodput(load.bytes, Phy::Le1M, LlPayload::Bytes27);
        if load.kb_per_s < least {
            found.push(format!(
                "{label}: {:.1} kB/s with messages of {} bytes, expected at least {least:.1} kB/s (packets of 27 bytes).",
                load.kb_per_s, load.bytes
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        measure::goodput::Goodput,
        survey::{
            document::{Discovery, Link, Reconnection, Survey, Switch},
            label::Label,
        },
    };
    use rect::{Connection, ConnectionState};

    fn survey() -> Survey {
        let robots = ["wombat-1", "wombat-2"]
            .map(|name| (name.parse().expect("a name"), Default::default()));
        Survey::new(
            robots,
            Link::of(
                &Connection::of("ble", "wombat-2", ConnectionState::Connected),
                None,
            ),
        )
    }

    fn near() -> Place {
        let mut place = Place::new(&"1m".parse::<Label>().expect("a place"));
        place.path = Some("ble".to_owned());
        place.discovery = Some(Discovery {
            seconds: vec![0.2, 1.1],
            signal_dbm: Some(-45),
            error: None,
        });
        let load = Goodput {
            bytes: 4000,
            kb_per_s: 34.0,
            sent: 30,
            lost: 0,
        };
        place.sent = vec![load];
        place
    }

    #[test]
    fn theory_is_that_of_the_specification() {
        // A packet of 251 bytes, an empty one and two pauses: 2088 + 80 + 300 us.
        let long = goodput(251 - OVERHEAD_BYTES, Phy::Le1M, LlPayload::Bytes251);
        assert!((long - 227.0 / 2.468).abs() < 0.1, "{long}");
        let short = goodput(16_000, Phy::Le1M, LlPayload::Bytes27);
        assert!((39.0..40.0).contains(&short), "{short}");
        assert_eq!(free_space_dbm(10.0), -60.2);
    }

    #[test]
    fn a_healthy_link_does_not_deviate() {
        let mut survey = survey();
        survey.places.push(near());
        assert_eq!(deviations(&survey), Vec::<String>::new());
    }

    #[test]
    fn goodput_resembles_that_of_a_radio() {
        let mut place = near();
        assert_eq!(resembles(&place), Some("1M PHY, packets of 27 bytes"));
        place.sent[0].kb_per_s = 90.0;
        assert_eq!(resembles(&place), Some("1M PHY, packets of 251 bytes"));
        place.sent[0].kb_per_s = 1000.0;
        assert_eq!(resembles(&place), None);
        place.sent[0].kb_per_s = 34.0;
        place.distance_m = Some(30.0);
        assert_eq!(resembles(&place), None);
    }

    #[test]
    fn names_what_deviates() {
        let mut survey = survey();
        let mut slow = near();
        slow.sent[0].kb_per_s = 9.0;
        slow.sent[0].lost = 2;
        slow.discovery = Some(Discovery {
            seconds: vec![5.5],
            signal_dbm: Some(-80),
            error: Some("no advertisement".to_owned()),
        });
        survey.places.push(slow);
        survey.reconnections.push(Reconnection {
            noticed_s: 21.0,
            reachable_s: 9.0,
        });
        survey.switches.push(Switch {
            path: "ble".to_owned(),
            longest_round_trip_ms: Some(2500.0),
            lost: 1,
            ..Switch::default()
        });
        let found = deviations(&survey).join("\n");
        for part in [
            "no advertisement",
            "5.5 s",
            "21.0 s",
            "9.0 s after",
            "lost messages: 2",
            "9.0 kB/s",
            "-80 dBm",
            "2500 ms",
            "Lost messages while the link switched to ble: 1",
        ] {
            assert!(found.contains(part), "{part}: {found}");
        }
    }

    #[test]
    fn the_curves_of_the_simulated_air_are_those_of_a_survey() {
        let curves = curves().expect("JSON");
        assert_eq!(curves["simulated"]["format"], "rect-survey");
        assert!(curves["simulated"]["places"]
            .as_array()
            .is_some_and(|all| all.len() > 1));
    }
}
