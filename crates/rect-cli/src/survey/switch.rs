//! Measures a switch of paths: what messages notice when the Wi-Fi goes away or comes back.
use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use tokio::time::{sleep, Instant};

use super::{document::Switch, guide::Step, say, Surveyor};
use crate::{
    measure::{goodput, round_trip},
    Failure,
};

/// How long the switch may take after the step.
const LIMIT: Duration = Duration::from_secs(60);
/// How long messages are observed after it.
const AFTERWARDS: Duration = Duration::from_secs(3);
const POLL: Duration = Duration::from_millis(200);
/// Size of the messages that travel meanwhile, in bytes.
const LOAD_BYTES: usize = 1000;
/// The load of one measurement; another one follows until the switch has ended.
const LOAD_FOR: Duration = Duration::from_secs(2);

/// Sends requests and a load while `step` is carried out; `None` if it is skipped.
pub async fn measure(surveyor: &Surveyor<'_>, step: Step) -> Result<Option<Switch>, Failure> {
    let Surveyor { robot, other, .. } = *surveyor;
    let before = surveyor.link().await?.switches;
    let ends = AtomicBool::new(false);
    let goes_on = || !ends.load(Ordering::Relaxed);
    let switching = async {
        let switched = wait_for_switch(surveyor, &step, before).await;
        ends.store(true, Ordering::Relaxed);
        switched
    };
    let loading = async {
        let (mut sent, mut lost) = (0, 0);
        while goes_on() {
            let one = goodput::to(robot, other, LOAD_BYTES, LOAD_FOR).await?;
            sent += one.sent;
            lost += one.lost;
        }
        Ok::<_, Failure>((sent, lost))
    };
    let asking = round_trip::measure_while(robot, other, goes_on, |_| {});
    let (switched, loaded, asked) = tokio::join!(switching, loading, asking);
    let Some(mut switch) = switched? else {
        return Ok(None);
    };
    let (sent, lost) = loaded?;
    let asked = asked?;
    switch.sent = sent;
    switch.lost = lost + asked.lost as u64;
    switch.longest_round_trip_ms = asked.quantile_ms(1.0);
    say(&format!(
        "  now over {}, longest round trip {:.0} ms, {} messages lost",
        switch.path,
        switch.longest_round_trip_ms.unwrap_or(f64::NAN),
        switch.lost
    ));
    Ok(Some(switch))
}

async fn wait_for_switch(
    surveyor: &Surveyor<'_>,
    step: &Step,
    before: Option<u64>,
) -> Result<Option<Switch>, Failure> {
    if surveyor.guide.ask(step).await?.is_none() {
        return Ok(None);
    }
    let deadline = Instant::now() + LIMIT;
    while Instant::now() < deadline {
        let link = surveyor.link().await?;
        if let Some(last) = link.last_switch.filter(|_| link.switches > before) {
            sleep(AFTERWARDS).await;
            return Ok(Some(Switch {
                path: last.path,
                reason: last.reason.as_str().to_owned(),
                gap_ms: last.gap_ms,
                ..Switch::default()
            }));
        }
        sleep(POLL).await;
    }
    say("  the link has not changed its path: not measured");
    Ok(None)
}
