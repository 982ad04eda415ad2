//! Tests of streams over two routers and the simulated air: `cargo test -p rect-router --test timing stream`
//!
//! The air is as slow as a Pi 3B's radio, with link-layer packets of 27 bytes: 34 to 37 kB/s. `benches/stream.py` measures the
//! exact figures; the bounds here leave a margin for a busy machine.

use std::{
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use crate::support::{joined, simulated, Air, Router, DEADLINE};
use rect::{Encoding, Frame, Options, Payload, Robot, StreamOptions, StreamSender, Watcher};
use rect_core::stream::ladder::{Coding, Step, PICTURES};
use zenoh_link_ble_air::{AirOptions, LlPayload};

const PIXELS: usize = 320 * 240;

/// The routers of two linked robots, with their endpoints for programs.
struct Robots {
    _air: Air,
    _routers: [Router; 2],
    endpoints: [String; 2],
}

fn robots() -> Robots {
    let air = Air::with(AirOptions {
        pdu: LlPayload::Bytes27,
        ..AirOptions::default()
    });
    let (one, local) = simulated(&air, 1, &[]);
    let (two, remote) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    Robots {
        _air: air,
        _routers: [one, two],
        endpoints: [local, remote],
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Runtime::new().expect("a runtime")
}

async fn stream(sender: &Robot) -> Arc<StreamSender> {
    let stream = sender.stream("camera", StreamOptions::default()).await;
    Arc::new(stream.expect("a stream"))
}

/// Sends frames at 20 Hz from a thread until the session ends, with sizes like those of photographs.
fn camera(stream: Arc<StreamSender>) {
    thread::spawn(move || {
        let started = Instant::now();
        for n in 0.. {
            let due = started + n * Duration::from_millis(50);
            thread::sleep(due.saturating_duration_since(Instant::now()));
            let sent = stream.send_with(PIXELS, |step| Ok(picture(step.expect("adaptive"), n)));
            // The test has ended.
            if sent.is_err() {
                return;
            }
        }
    });
}

fn picture(step: Step, n: u32) -> Payload {
    let (per_pixel, encoding) = match step.coding {
        Coding::Lossless => (1.5, Encoding::PNG),
        Coding::Lossy(quality) => (0.02 + f64::from(quality) / 400.0, Encoding::JPEG),
    };
    let area = (f64::from(step.quarters) / 4.0).powi(2);
    let variation = 0.9 + f64::from(n % 5) * 0.05;
    Payload::new(
        vec![7; (PIXELS as f64 * per_pixel * area * variation) as usize],
        encoding,
    )
}

/// Returns the frames that arrive within `lasts`.
async fn frames(watch: &Watcher, lasts: Duration) -> Vec<Frame> {
    let (started, mut frames) = (Instant::now(), Vec::new());
    while let Some(left) = lasts.checked_sub(started.elapsed()) {
        match tokio::time::timeout(left, watch.next()).await {
            Ok(frame) => frames.push(frame.expect("the session lives")),
            Err(_) => break,
        }
    }
    frames
}

/// Returns the 99th percentile.
fn p99_of(mut values: Vec<Duration>) -> Duration {
    values.sort();
    values[(values.len() * 99 / 100).min(values.len() - 1)]
}

async fn first(watch: &Watcher) -> Frame {
    let frame = tokio::time::timeout(DEADLINE, watch.next()).await;
    frame.expect("in time").expect("the session lives")
}

#[test]
fn a_slow_link_carries_fresh_frames_and_timely_urgent_messages() {
    let robots = robots();
    runtime().block_on(one_camera(&robots.endpoints));
}

async fn one_camera([local, remote]: &[String; 2]) {
    let (sender, receiver) = (
        joined("wombat-1", local).await,
        joined("wombat-2", remote).await,
    );
    let stream = stream(&sender).await;
    let watch = receiver.watch("wombat-1/camera").await.expect("watched");
    let begun = Instant::now();
    let ages: Arc<Mutex<Vec<Duration>>> = Arc::default();
    let received_ages = ages.clone();
    let _urgent = receiver
        .on_message::<Payload>("wombat-1/stop", move |message| {
            let sent_us: u64 = message.payload.value().expect("a number");
            let age = begun.elapsed() - Duration::from_micros(sent_us);
            received_ages.lock().expect("unpoisoned").push(age);
        })
        .await
        .expect("subscribed");
    camera(stream.clone());
    first(&watch).await;
    frames(&watch, Duration::from_secs(6)).await;
    ages.lock().expect("unpoisoned").clear();
    let urgent = tokio::spawn(async move {
        let sender = sender.urgent();
        let mut ticks = tokio::time::interval(Duration::from_millis(100));
        for _ in 0..100 {
            ticks.tick().await;
            let sent_us = u64::try_from(begun.elapsed().as_micros()).expect("short");
            sender
                .publish("stop", rect::Json(sent_us))
                .await
                .expect("sent");
        }
    });
    let seen = frames(&watch, Duration::from_secs(10)).await;
    urgent.await.expect("sent");
    tokio::time::sleep(Duration::from_millis(500)).await;

    let status = stream.status();
    let bytes: usize = seen.iter().map(|frame| frame.payload.bytes.len()).sum();
    let oldest = p99_of(
        seen.iter()
            .map(|frame| frame.age.expect("a known age"))
            .collect(),
    );
    let ages = ages.lock().expect("unpoisoned").clone();
    println!(
        "{} frames, {} kB/s, age p99 {oldest:?}, urgent p99 {:?}",
        seen.len(),
        bytes / 10_000,
        p99_of(ages.clone())
    );
    assert!(
        seen.len() >= 50,
        "{} frames in 10 s: {status:?}",
        seen.len()
    );
    assert!(bytes >= 200_000, "{bytes} bytes in 10 s: {status:?}");
    assert!(oldest < Duration::from_secs(1), "{oldest:?}: {status:?}");
    assert_eq!(ages.len(), 100, "urgent messages");
    assert!(
        p99_of(ages.clone()) < Duration::from_millis(250),
        "{ages:?}"
    );
}

#[test]
fn a_local_watcher_gets_lossless_frames_while_a_bluetooth_watcher_gets_smaller_ones() {
    let robots = robots();
    runtime().block_on(two_watchers(&robots.endpoints));
}

async fn two_watchers([local, remote]: &[String; 2]) {
    let sender = joined("wombat-1", local).await;
    let robot = joined("wombat-2", remote).await;
    // The laptop connects to the robot's router directly, so the names differ.
    let laptop = Options::new("laptop").expect("a name").login_file("/none");
    let laptop = laptop.router(local).allow_name_mismatch().connect().await;
    let laptop = laptop.expect("joined");
    let stream = stream(&sender).await;
    let slow = robot.watch("wombat-1/camera").await.expect("watched");
    let fast = laptop.watch("wombat-1/camera").await.expect("watched");
    camera(stream.clone());
    let begun = Instant::now();
    while first(&fast).await.payload.encoding != Encoding::PNG {
        assert!(begun.elapsed() < DEADLINE, "{:?}", stream.status());
    }
    first(&slow).await;
    let (clear, fits) = tokio::join!(
        frames(&fast, Duration::from_secs(10)),
        frames(&slow, Duration::from_secs(10)),
    );
    let status = stream.status();
    assert_eq!(status.groups.len(), 2, "{status:?}");
    let lossless = clear
        .iter()
        .filter(|frame| frame.payload.encoding == Encoding::PNG)
        .count();
    assert!(lossless >= 80, "{lossless} of {}: {status:?}", clear.len());
    assert!(fits.len() >= 40, "{}: {status:?}", fits.len());
    assert!(
        fits.iter()
            .all(|frame| frame.payload.encoding == Encoding::JPEG),
        "{status:?}"
    );
    assert!(
        status.groups[1]
            .step
            .is_some_and(|step| step != PICTURES[0]),
        "{status:?}"
    );
}
