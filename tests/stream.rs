//! Streams between programs linked over TCP: `cargo test -p rect --no-default-features --features session --test stream`
mod pair;

use std::{
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use pair::{pair, PATIENCE};
use rect::{
    core::stream::ladder::{Coding, Level, PICTURES},
    Encoding, Frame, Payload, Stream, StreamOptions, Watch,
};

const PIXELS: usize = 160 * 120;

/// A camera at 20 Hz, whose frames take what photographs do, about; until it is dropped.
struct Camera {
    encoded: Arc<AtomicUsize>,
    stream: Arc<Stream>,
    task: tokio::task::JoinHandle<()>,
}

fn camera(stream: Stream) -> Camera {
    let (stream, encoded) = (Arc::new(stream), Arc::new(AtomicUsize::new(0)));
    let (sends, count) = (stream.clone(), encoded.clone());
    let task = tokio::spawn(async move {
        let mut ticks = tokio::time::interval(Duration::from_millis(50));
        loop {
            ticks.tick().await;
            let sent = sends.send_with(PIXELS, |level| {
                count.fetch_add(1, Ordering::Relaxed);
                Ok(picture(level.expect("adaptive")))
            });
            sent.expect("sent");
        }
    });
    Camera {
        encoded,
        stream,
        task,
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn picture(level: Level) -> Payload {
    let (share, encoding) = match level.coding {
        Coding::Lossless => (1.5, Encoding::PNG),
        Coding::Lossy(quality) => (f64::from(quality) / 300.0, Encoding::JPEG),
    };
    let area = (f64::from(level.quarters) / 4.0).powi(2);
    Payload::new(vec![7; (PIXELS as f64 * share * area) as usize], encoding)
}

async fn next(watch: &Watch) -> Frame {
    let frame = tokio::time::timeout(PATIENCE, watch.recv()).await;
    frame.expect("a frame in time").expect("the session lives")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sensors_values_come_as_they_are_with_number_and_age() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let watch = two
        .watch_with("wombat-1", "distance", rect::Receiving::default())
        .await
        .expect("watched");
    let stream = one
        .stream("distance", StreamOptions::sensor())
        .await
        .expect("a stream");
    let begun = Instant::now();
    while stream.send([0u8; 2]).expect("sent") == 0 {
        assert!(begun.elapsed() < PATIENCE, "nobody listens");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let first = next(&watch).await;
    for n in 1..100u8 {
        assert_eq!(stream.send([n, n]).expect("sent"), 1);
        let frame = next(&watch).await;
        assert_eq!(frame.payload.bytes.as_ref(), [n, n]);
        assert_eq!(
            (frame.number, frame.skipped),
            (first.number + u32::from(n), 0)
        );
        assert!(
            frame.age.expect("told") < Duration::from_secs(1),
            "{frame:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_adaptive_stream_is_lossless_where_there_is_room_and_says_why() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let stream = one
        .stream("camera", StreamOptions::default())
        .await
        .expect("a stream");
    let camera = camera(stream);
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(camera.encoded.load(Ordering::Relaxed), 0, "nobody listens");
    let watch = two.watch("wombat-1", "camera").await.expect("watched");
    let begun = Instant::now();
    let mut last = next(&watch).await;
    while last.payload.encoding != Encoding::PNG {
        assert!(begun.elapsed() < PATIENCE, "{:?}", camera.stream.status());
        let frame = next(&watch).await;
        assert!(frame.number > last.number, "{frame:?} after {last:?}");
        assert!(
            frame.age.expect("told") < Duration::from_secs(1),
            "{frame:?}"
        );
        last = frame;
    }
    assert!(watch.round_trip().is_some());
    let status = camera.stream.status();
    assert_eq!(status.groups[0].level, Some(PICTURES[0]));
    let why = status.groups[0].last_change.as_deref().expect("a reason");
    assert!(
        why.contains("to lossless: ") && why.contains("kB/s get through"),
        "{why}"
    );
    assert_eq!(status.receivers[0].robot, "wombat-2");
    // Without anyone, nothing is encoded any more.
    drop(watch);
    let begun = Instant::now();
    loop {
        let before = camera.encoded.load(Ordering::Relaxed);
        tokio::time::sleep(Duration::from_millis(300)).await;
        if camera.encoded.load(Ordering::Relaxed) == before {
            break;
        }
        assert!(begun.elapsed() < PATIENCE, "it goes on");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_is_slow_to_take_gets_the_newest_and_how_many_it_did_not_see() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let watch = two.watch("wombat-1", "camera").await.expect("watched");
    let camera = camera(
        one.stream("camera", StreamOptions::default())
            .await
            .expect("a stream"),
    );
    let first = next(&watch).await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let second = next(&watch).await;
    assert!(second.skipped > 3, "{second:?}");
    assert_eq!(second.number, first.number + 1 + second.skipped);
    drop(camera);
}

#[tokio::test(flavor = "multi_thread")]
async fn stock_programs_see_the_frames_and_their_frames_are_seen() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let camera = camera(
        one.stream("camera", StreamOptions::default())
            .await
            .expect("a stream"),
    );
    let stock = two
        .zenoh()
        .declare_subscriber("rect/*/camera")
        .await
        .expect("subscribed");
    let sample = tokio::time::timeout(PATIENCE, stock.recv_async())
        .await
        .expect("in time")
        .expect("a frame");
    assert_eq!(sample.key_expr().as_str(), "rect/wombat-1/camera");
    assert_eq!(sample.encoding().to_string(), "image/jpeg");
    drop(camera);

    let watch = one.watch("wombat-2", "stock").await.expect("watched");
    let begun = Instant::now();
    let frame = loop {
        two.zenoh()
            .put("rect/wombat-2/stock", "hello")
            .await
            .expect("put");
        tokio::time::sleep(Duration::from_millis(50)).await;
        if let Some(frame) = watch.try_recv() {
            break frame;
        }
        assert!(begun.elapsed() < PATIENCE, "no frame");
    };
    assert_eq!(
        (frame.payload.bytes.as_ref(), frame.age),
        (b"hello".as_slice(), None)
    );
}
