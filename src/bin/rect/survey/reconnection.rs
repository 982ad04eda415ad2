//! Measures how soon the robots reach each other again after the radio was off.
use std::time::Duration;

use rect::{Name, Robot};
use tokio::time::{sleep, timeout};

use super::{
    document::Reconnection,
    guide::{Guide, Step},
    say,
};
use crate::Failure;

/// How long the loss of the link may take to be noticed.
const LOST_WITHIN: Duration = Duration::from_secs(60);
/// How long the return of the link may take.
const BACK_WITHIN: Duration = Duration::from_secs(120);
const POLL: Duration = Duration::from_millis(50);

/// Measures once; nothing, if the step is skipped.
pub async fn measure(
    robot: &Robot,
    other: &Name,
    guide: &Guide,
) -> Result<Vec<Reconnection>, Failure> {
    let Some(off) = guide.ask(&Step::RadioOff).await? else {
        return Ok(Vec::new());
    };
    if timeout(LOST_WITHIN, wait_until_lost(robot, other))
        .await
        .is_err()
    {
        say("  the robots still reach each other, over another path: not measured");
        return Ok(Vec::new());
    }
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

async fn wait_until_lost(robot: &Robot, other: &Name) {
    while robot.peers().await.is_ok_and(|peers| peers.contains(other)) {
        sleep(POLL).await;
    }
}
