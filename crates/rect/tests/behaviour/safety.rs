//! Tests the dead man's switch and the stop of a fleet: `cargo test -p rect-robot --test behaviour safety`
use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use rect::{Confirmation, Deadman, Json, Publisher, Robot};
use tokio::time::{sleep, timeout};

use crate::pair::{pair, TIMEOUT};

/// The history of a robot: commands, and why it has lost its commander.
#[derive(Clone, Default)]
struct Motors(Arc<Mutex<Vec<String>>>);

impl Motors {
    async fn following(&self, robot: &Robot, within_ms: u64) -> Deadman {
        let (on_command, on_lost) = (self.clone(), self.clone());
        let within = Duration::from_millis(within_ms);
        let switch = robot.deadman::<f64>(
            "laptop/drive",
            within,
            move |speed| on_command.add(format!("drive {speed}")),
            move |reason| on_lost.add(format!("lost: {reason}")),
        );
        switch.await.expect("a switch")
    }

    fn add(&self, entry: String) {
        self.0.lock().expect("not poisoned").push(entry);
    }

    /// Waits for something that the robot does next, and forgets what it did before.
    async fn until(&self, expected: &str) {
        let is_done = || {
            let mut all = self.0.lock().expect("not poisoned");
            let at = all.iter().position(|entry| entry.contains(expected));
            at.map(|at| all.drain(..=at).count()).is_some()
        };
        let done = async {
            while !is_done() {
                sleep(Duration::from_millis(5)).await;
            }
        };
        let all = || self.0.lock().expect("not poisoned").join("; ");
        timeout(TIMEOUT, done)
            .await
            .unwrap_or_else(|_| panic!("no {expected}: {}", all()));
    }

    fn all(&self) -> Vec<String> {
        self.0.lock().expect("not poisoned").clone()
    }
}

/// Declares the publisher of commands, once their subscriber is known: an ordinary message that is published before is lost.
async fn stick(laptop: &Robot) -> Publisher<f64> {
    let stick = laptop.publisher("drive").await.expect("a publisher");
    let subscribed = stick.wait_for_subscriber(TIMEOUT).await;
    subscribed.expect("a subscriber");
    stick
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_follows_while_commands_arrive() {
    let (laptop, robot) = pair("laptop", "wombat").await;
    let motors = Motors::default();
    let switch = motors.following(&robot, 1000).await;
    motors.until("lost: no command has arrived yet").await;
    let stick = stick(&laptop).await;
    // A retained message is not a sign of life.
    laptop
        .retained()
        .publish("drive", Json(9.0))
        .await
        .expect("kept");
    stick.publish(0.5).await.expect("sent");
    motors.until("drive 0.5").await;
    assert!(switch.is_following());
    motors.until("lost: no command of laptop for 1 s").await;
    assert!(!switch.is_following());
    stick.publish(0.7).await.expect("sent");
    motors.until("drive 0.7").await;
    laptop.close().await.expect("closed");
    motors.until("lost: ").await;
    drop(switch);
    motors.until("lost: the dead man's switch has ended").await;
    assert!(motors.all().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_hangs_does_not_delay_the_loss() {
    let (laptop, robot) = pair("laptop", "wombat").await;
    let (motors, on_lost) = (Motors::default(), Motors::default());
    let (returns, may_return) = std::sync::mpsc::channel::<()>();
    let (commands, losses) = (motors.clone(), on_lost.clone());
    let within = Duration::from_millis(200);
    let switch = robot.deadman::<f64>(
        "laptop/drive",
        within,
        move |speed| {
            commands.add(format!("drive {speed}"));
            may_return.recv().expect("the test goes on");
        },
        move |reason| losses.add(format!("lost: {reason}")),
    );
    let switch = switch.await.expect("a switch");
    on_lost.until("lost: no command has arrived yet").await;
    let stick = stick(&laptop).await;
    stick.publish(0.5).await.expect("sent");
    motors.until("drive 0.5").await;
    // Commands that arrive meanwhile are not a sign of life.
    stick.publish(0.6).await.expect("sent");
    on_lost.until("lost: no command of laptop for 200 ms").await;
    assert!(!switch.is_following());
    assert!(on_lost.all().is_empty() && motors.all().is_empty());
    // It may have started the motors before it returns.
    returns.send(()).expect("it waits");
    on_lost.until("lost: no command of laptop for 200 ms").await;
    motors.until("drive 0.6").await;
    drop(switch);
    on_lost.until("lost: the dead man's switch has ended").await;
    returns.send(()).expect("it waits");
    on_lost.until("lost: the dead man's switch has ended").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_holds_until_it_is_released_and_the_stick_is_neutral() {
    let (laptop, robot) = pair("laptop", "wombat").await;
    let motors = Motors::default();
    let _switch = motors.following(&robot, 60_000).await;
    let stick = stick(&laptop).await;
    let stop = laptop.fleet_stop().await.expect("takes part");
    let mut changes = stop.changes();
    stick.publish(0.5).await.expect("sent");
    motors.until("drive 0.5").await;
    stop.press("smoke").await.expect("pressed");
    motors.until("lost: stopped by laptop: smoke").await;
    let wombat = robot.name().clone();
    let confirmed = async {
        while stop.confirmation(&wombat) != Some(Confirmation::Confirmed) {
            changes.next().await.expect("takes part");
        }
    };
    timeout(TIMEOUT, confirmed).await.expect("confirmed");
    stick.publish(0.0).await.expect("sent");
    stick.publish(0.6).await.expect("sent");
    // The robot releases it itself, and the laptop learns of that.
    let own = robot.fleet_stop().await.expect("the same one");
    assert!(own.is_stopped() && own.pressed()[0].reason == "smoke");
    sleep(Duration::from_millis(100)).await;
    own.release().await.expect("released");
    let released = async {
        while stop.is_stopped() {
            changes.next().await.expect("takes part");
        }
    };
    timeout(TIMEOUT, released).await.expect("released");
    for speed in [0.8, 0.0, 0.9] {
        stick.publish(speed).await.expect("sent");
    }
    motors.until("drive 0.9").await;
    let before = motors.all();
    assert!(before.is_empty(), "{before:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_comes_later_is_stopped() {
    let (laptop, robot) = pair("laptop", "wombat").await;
    let stop = laptop.fleet_stop().await.expect("takes part");
    assert_eq!(stop.confirmation(robot.name()), None);
    stop.press("").await.expect("pressed");
    let motors = Motors::default();
    let _switch = motors.following(&robot, 60_000).await;
    let stick = stick(&laptop).await;
    let own = robot.fleet_stop().await.expect("takes part");
    let mut changes = own.changes();
    let stopped = async {
        while !own.is_stopped() {
            changes.next().await.expect("takes part");
        }
    };
    timeout(TIMEOUT, stopped).await.expect("stopped");
    stick.publish(0.5).await.expect("sent");
    sleep(Duration::from_millis(100)).await;
    assert_eq!(motors.all(), ["lost: no command has arrived yet"]);
}
