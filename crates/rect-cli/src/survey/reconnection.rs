//! Measures how soon the robots reach each other again after the radio was off.
use std::time::Duration;

use tokio::time::{sleep, timeout};

use super::{document::Reconnection, guide::Step, say, Surveyor, POLL};
use crate::Failure;

/// How long the loss of the link may take to be noticed.
const LOST_WITHIN: Duration = Duration::from_secs(60);
/// How long the return of the link may take.
const BACK_WITHIN: Duration = Duration::from_secs(120);

/// Measures once; nothing, if the step is skipped.
pub async fn measure(surveyor: &Surveyor<'_>) -> Result<Vec<Reconnection>, Failure> {
    let Surveyor {
        robot,
        other,
        guide,
        ..
    } = *surveyor;
    let Some(off) = guide.ask(&Step::RadioOff).await? else {
        return Ok(Vec::new());
    };
    // The registry comes first: it is on this computer, while a question to all routers only gets no answer from the other one.
    let lost = async {
        while surveyor.linked().await?.is_some() {
            sleep(POLL).await;
        }
        while robot.peers().await?.contains(other) {
            sleep(POLL).await;
        }
        Ok::<_, Failure>(())
    };
    let Ok(lost) = timeout(LOST_WITHIN, lost).await else {
        say("  the robots still reach each other, over another path: not measured");
        return Ok(Vec::new());
    };
    lost?;
    let noticed_s = off.elapsed().as_secs_f64();
    say(&format!("  noticed after {noticed_s:.1} s"));
    let Some(on) = guide.ask(&Step::RadioOn).await? else {
        return Ok(Vec::new());
    };
    robot.wait_for_peer(other, BACK_WITHIN).await?;
    let reachable_s = on.elapsed().as_secs_f64();
    say(&format!("  reachable again after {reachable_s:.1} s"));
    Ok(vec![Reconnection {
        noticed_s,
        reachable_s,
    }])
}
