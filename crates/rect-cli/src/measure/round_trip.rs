//! Measures the round trip to the other robot.
use std::time::{Duration, Instant};

use rect::{Name, Payload, Robot};
use tokio::time::sleep;

use super::{not_served, partner::ECHO};
use crate::Failure;

/// Size of a request, in bytes, similar to a command or a sensor value.
pub const PING_BYTES: usize = 16;
/// The pause between a reply and the next request.
const PAUSE: Duration = Duration::from_millis(20);

/// The round trips of requests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoundTrips {
    /// In milliseconds, the shortest first.
    times_ms: Vec<f64>,
    /// Requests without a reply.
    pub lost: usize,
}

impl RoundTrips {
    /// Returns the number of replies.
    pub fn replies(&self) -> usize {
        self.times_ms.len()
    }

    /// Returns the round trip in milliseconds that `share` of the requests did not exceed; `None` without a reply.
    pub fn quantile_ms(&self, share: f64) -> Option<f64> {
        let last = self.times_ms.len().checked_sub(1)?;
        let at = (last as f64 * share).round() as usize;
        self.times_ms.get(at).copied()
    }
}

/// Measures the round trip of urgent requests for `duration`. `on_reply` is called with the time that each has taken.
pub async fn measure(
    robot: &Robot,
    other: &Name,
    duration: Duration,
    on_reply: impl Fn(Duration),
) -> Result<RoundTrips, Failure> {
    let end = Instant::now() + duration;
    measure_while(robot, other, || Instant::now() < end, on_reply).await
}

/// Measures the round trip of urgent requests while `goes_on` returns `true`.
pub async fn measure_while(
    robot: &Robot,
    other: &Name,
    goes_on: impl Fn() -> bool,
    on_reply: impl Fn(Duration),
) -> Result<RoundTrips, Failure> {
    let urgent = robot.urgent();
    let mut measured = RoundTrips::default();
    while goes_on() {
        let asked = Instant::now();
        let reply = urgent.request::<Payload>(other, ECHO, [0u8; PING_BYTES]);
        match reply.await {
            Ok(_) => measured
                .times_ms
                .push(asked.elapsed().as_secs_f64() * 1000.0),
            Err(rect::Error::TimedOut { .. }) => measured.lost += 1,
            Err(error) => return Err(not_served(other, &error)),
        }
        sleep(PAUSE).await;
        on_reply(asked.elapsed());
    }
    measured.times_ms.sort_by(f64::total_cmp);
    Ok(measured)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_round_trips() {
        let none = RoundTrips::default();
        assert_eq!(none.quantile_ms(0.5), None);
        let some = RoundTrips {
            times_ms: vec![1.0, 2.0, 10.0],
            lost: 0,
        };
        let quantiles = [0.0, 0.5, 0.99].map(|share| some.quantile_ms(share));
        assert_eq!(quantiles, [Some(1.0), Some(2.0), Some(10.0)]);
    }
}
