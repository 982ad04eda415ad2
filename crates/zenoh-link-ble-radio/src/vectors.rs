//! Tests advertisements and connection intervals with the vectors that an independent implementation
//! (`tests/protocol/link_messages.py`) has written from `PROTOCOL.md`: `cargo test -p zenoh-link-ble-radio --lib vectors`
use serde::Deserialize;

use crate::{
    address::Psm, advertisement::Advertisement, interval::ConnectionInterval,
    interval_table::agreed,
};

#[derive(Deserialize)]
struct Vectors {
    conflicts: Vec<(u16, u16, bool)>,
    agreed: Vec<Agreed>,
    advertisements: Vec<Advertised>,
}

/// The interval of a link, by the one that the central requests and those that each side avoids.
#[derive(Deserialize)]
struct Agreed {
    requested: u16,
    central: Vec<u16>,
    peripheral: Vec<u16>,
    interval: u16,
}

#[derive(Deserialize)]
struct Advertised {
    name: String,
    fleet: String,
    psm: u16,
    plain: bool,
    incarnation: u16,
    data: String,
}

fn vectors() -> Vectors {
    let text = include_str!("../vectors/radio.json");
    serde_json::from_str(text).expect("valid")
}

fn units(units: u16) -> ConnectionInterval {
    ConnectionInterval::from_units(units).expect("valid")
}

#[test]
fn intervals_are_chosen_as_documented() {
    let vectors = vectors();
    for (one, other, conflict) in vectors.conflicts {
        assert_eq!(
            units(one).conflicts_with(units(other)),
            conflict,
            "{one} {other}"
        );
    }
    for Agreed {
        requested,
        central,
        peripheral,
        interval,
    } in vectors.agreed
    {
        let [central, peripheral] =
            [central, peripheral].map(|avoid| Vec::from_iter(avoid.into_iter().map(units)));
        let chosen = agreed(units(requested), &central, &peripheral);
        assert_eq!(
            chosen.units(),
            interval,
            "{requested} {central:?} {peripheral:?}"
        );
    }
}

#[test]
fn advertisements_have_the_documented_bytes() {
    for Advertised {
        name,
        fleet,
        psm,
        plain,
        incarnation,
        data,
    } in vectors().advertisements
    {
        let fleet_hash = match fleet.as_str() {
            "" => 0,
            fleet => Advertisement::hash_of_fleet(fleet),
        };
        let advertisement = Advertisement {
            psm: Psm::new(psm).expect("valid"),
            plain,
            name_hash: Advertisement::hash_of_name(&name),
            fleet_hash,
            incarnation,
        };
        let encoded = advertisement.encode().map(|byte| format!("{byte:02x}"));
        assert_eq!(encoded.concat(), data, "{name}");
    }
}
