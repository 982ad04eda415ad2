//! Measures the link at one place.
use super::{discovery, document::Place, is_live, label::Label, say, Surveyor, TCP};
use crate::{
    measure::{goodput, round_trip},
    Failure,
};

/// Sizes of messages for which goodput is measured, in bytes.
const SIZES: [usize; 4] = [100, 1000, 4000, 16_000];
/// The size for which both directions are measured.
const BOTH_WAYS: usize = 4000;

/// Measures round trip, goodput and losses.
pub async fn measure(surveyor: &Surveyor<'_>, label: &Label) -> Result<Place, Failure> {
    let Surveyor {
        robot,
        other,
        partner,
        duration,
        ..
    } = *surveyor;
    let mut place = Place::new(label);
    if !is_live(&surveyor.link().await?, TCP) {
        say("  discovery");
        place.discovery = Some(discovery::measure(surveyor.adapter, other).await);
    }
    say("  round trip");
    place.round_trip = Some(
        round_trip::measure(robot, other, duration, |_| {})
            .await?
            .into(),
    );
    for bytes in SIZES {
        say(&format!("  messages of {bytes} bytes"));
        let is_loaded = bytes == BOTH_WAYS;
        if is_loaded {
            let (sent, urgent) = tokio::join!(
                goodput::to(robot, other, bytes, duration),
                round_trip::measure(robot, other, duration, |_| {})
            );
            place.sent.push(sent?);
            place.round_trip_under_load = Some(urgent?.into());
            let received = goodput::from(robot, partner, other, bytes, duration).await?;
            place.received.push(received);
        } else {
            place
                .sent
                .push(goodput::to(robot, other, bytes, duration).await?);
        }
    }
    let link = surveyor.link().await?;
    let primary = link.paths.iter().flatten().find(|path| path.is_primary);
    place.path = Some(primary.map_or(&link.method, |path| &path.method).clone());
    Ok(place)
}
