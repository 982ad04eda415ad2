//! Tests streams between two robots, linked directly over TCP in one process:
//! `cargo test -p rect-robot --test timing stream`
use std::{
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use rect::{
    Encoding, Frame, Payload, QueueOptions, StreamOptions, StreamSender, Watcher, WhenFull,
};
use rect_core::{
    codec::picture::{Format, Picture},
    stream::ladder::{Coding, Step, PICTURES},
    video::bitstream::is_key_frame,
};

use crate::pair::{pair, TIMEOUT};

const PIXELS: usize = 160 * 120;

/// A camera at 20 Hz whose frames have about the size of photographs. Dropping it stops the camera.
struct Camera {
    /// Number of frames encoded so far.
    encoded: Arc<AtomicUsize>,
    stream: Arc<StreamSender>,
    task: tokio::task::JoinHandle<()>,
}

fn camera(stream: StreamSender) -> Camera {
    let (stream, encoded) = (Arc::new(stream), Arc::new(AtomicUsize::new(0)));
    let (sender, count) = (stream.clone(), encoded.clone());
    let task = tokio::spawn(async move {
        let mut ticks = tokio::time::interval(Duration::from_millis(50));
        loop {
            ticks.tick().await;
            let sent = sender.send_with(PIXELS, |step| {
                count.fetch_add(1, Ordering::Relaxed);
                Ok(picture(step.expect("adaptive")))
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

/// Returns a payload of the size that a picture would have at `step`.
fn picture(step: Step) -> Payload {
    let (share, encoding) = match step.coding {
        Coding::Lossless => (1.5, Encoding::PNG),
        Coding::Lossy(quality) => (f64::from(quality) / 300.0, Encoding::JPEG),
    };
    let area = (f64::from(step.quarters) / 4.0).powi(2);
    Payload::new(vec![7; (PIXELS as f64 * share * area) as usize], encoding)
}

async fn next(watch: &Watcher) -> Frame {
    let frame = tokio::time::timeout(TIMEOUT, watch.next()).await;
    frame.expect("a frame in time").expect("open")
}

#[tokio::test(flavor = "multi_thread")]
async fn sensor_frames_arrive_unchanged_with_number_and_age() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let watch = two
        .watch_with("wombat-1/distance", rect::QueueOptions::default())
        .await
        .expect("watched");
    let stream = one
        .stream("distance", StreamOptions::sensor())
        .await
        .expect("a stream");
    let begun = Instant::now();
    while stream.send([0u8; 2]).expect("sent") == 0 {
        assert!(begun.elapsed() < TIMEOUT, "no receiver");
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
            frame.age.expect("known") < Duration::from_secs(1),
            "{frame:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn adaptive_stream_becomes_lossless_on_a_fast_link_and_reports_the_reason() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let stream = one
        .stream("camera", StreamOptions::default())
        .await
        .expect("a stream");
    let camera = camera(stream);
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(camera.encoded.load(Ordering::Relaxed), 0, "no receiver");
    let watch = two.watch("wombat-1/camera").await.expect("watched");
    let begun = Instant::now();
    let mut last = next(&watch).await;
    while last.payload.encoding != Encoding::PNG {
        assert!(begun.elapsed() < TIMEOUT, "{:?}", camera.stream.status());
        let frame = next(&watch).await;
        assert!(frame.number > last.number, "{frame:?} after {last:?}");
        assert!(
            frame.age.expect("known") < Duration::from_secs(1),
            "{frame:?}"
        );
        last = frame;
    }
    assert!(watch.round_trip().is_some());
    let status = camera.stream.status();
    assert_eq!(status.groups[0].step, Some(PICTURES[0]));
    let reason = status.groups[0].last_change.as_deref().expect("a reason");
    assert!(
        reason.contains("to lossless: ") && reason.contains("the capacity is "),
        "{reason}"
    );
    assert_eq!(status.receivers[0].robot, "wombat-2");
    // Without receivers, no more frames are encoded.
    drop(watch);
    let begun = Instant::now();
    loop {
        let before = camera.encoded.load(Ordering::Relaxed);
        tokio::time::sleep(Duration::from_millis(300)).await;
        if camera.encoded.load(Ordering::Relaxed) == before {
            break;
        }
        assert!(begun.elapsed() < TIMEOUT, "frames are still encoded");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_reader_gets_the_newest_frame_and_the_number_of_skipped_ones() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let watch = two.watch("wombat-1/camera").await.expect("watched");
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
async fn streams_interoperate_with_stock_zenoh_programs() {
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
    let sample = tokio::time::timeout(TIMEOUT, stock.recv_async())
        .await
        .expect("in time")
        .expect("a frame");
    assert_eq!(sample.key_expr().as_str(), "rect/wombat-1/camera");
    assert_eq!(sample.encoding().to_string(), "image/jpeg");
    drop(camera);

    let watch = one.watch("wombat-2/stock").await.expect("watched");
    let begun = Instant::now();
    let frame = loop {
        two.zenoh()
            .put("rect/wombat-2/stock", "hello")
            .await
            .expect("put");
        tokio::time::sleep(Duration::from_millis(50)).await;
        if let Some(frame) = watch.try_next() {
            break frame;
        }
        assert!(begun.elapsed() < TIMEOUT, "no frame");
    };
    assert_eq!(
        (frame.payload.bytes.as_ref(), frame.age),
        (b"hello".as_slice(), None)
    );
}

/// A camera at 20 Hz whose picture moves, sent as video. Dropping it stops the camera.
fn video_camera(stream: StreamSender) -> Camera {
    let (stream, encoded) = (Arc::new(stream), Arc::new(AtomicUsize::new(0)));
    let (sender, count) = (stream.clone(), encoded.clone());
    let task = tokio::spawn(async move {
        let mut ticks = tokio::time::interval(Duration::from_millis(50));
        for n in 0.. {
            ticks.tick().await;
            let groups = sender.send_picture(&moving(n)).expect("sent");
            count.fetch_add(groups, Ordering::Relaxed);
        }
    });
    Camera {
        encoded,
        stream,
        task,
    }
}

fn moving(n: u32) -> Picture {
    let value = |at: u32| {
        128.0
            + 100.0
                * f64::from(at % 160 + at / 160 + n * 3)
                    .mul_add(0.05, 0.0)
                    .sin()
    };
    let pixels: Vec<u8> = (0..160 * 120).map(|at| value(at) as u8).collect();
    Picture::new(160, 120, Format::Grey8, pixels).expect("a picture")
}

const EVERY_FRAME: QueueOptions = QueueOptions {
    capacity: 100,
    when_full: WhenFull::DropOldest,
};

#[tokio::test(flavor = "multi_thread")]
async fn video_arrives_decoded_or_as_it_was_sent() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let options = StreamOptions::video();
    let camera = video_camera(one.stream("camera", options).await.expect("a stream"));
    let watch = two.watch("wombat-1/camera").await.expect("watched");
    for _ in 0..10 {
        let frame = next(&watch).await;
        let picture = frame.payload.picture(&rect_core::codec::Limits::default());
        let picture = picture.expect("decoded");
        assert_eq!((picture.width(), picture.height()), (160, 120));
        assert!(frame.sent_bytes < 19_200 / 4, "{}", frame.sent_bytes);
    }
    // A receiver that comes later begins with a key frame, which it asks for, and then misses none.
    let late = two.watch_with("wombat-1/camera", EVERY_FRAME).await;
    let late = late.expect("watched").undecoded();
    let first = next(&late).await;
    assert_eq!(first.payload.encoding, Encoding::H264);
    assert!(is_key_frame(&first.payload.bytes));
    for _ in 0..10 {
        let frame = next(&late).await;
        assert_eq!(frame.payload.encoding, Encoding::H264);
        assert_eq!(frame.skipped, 0);
    }
    // One that reads rarely gets the newest picture, which depends on all before it.
    tokio::time::sleep(Duration::from_millis(500)).await;
    let newest = next(&watch).await;
    assert!(newest.skipped > 3, "{newest:?}");
    assert!(newest
        .payload
        .picture(&rect_core::codec::Limits::default())
        .is_ok());
    let before = video_status(&camera).key_frames;
    late.ask_for_key_frame();
    let begun = Instant::now();
    while video_status(&camera).key_frames == before {
        assert!(begun.elapsed() < Duration::from_secs(5), "no key frame");
        next(&late).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_receivers_share_one_video_and_its_key_frames() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let options = StreamOptions::video();
    let camera = video_camera(one.stream("camera", options).await.expect("a stream"));
    let mut watches = Vec::new();
    for n in 0..10 {
        let watch = two.watch_with("wombat-1/camera", EVERY_FRAME).await;
        watches.push(watch.expect("watched").undecoded());
        // The stream may not be known yet. A receiver that learned of it after the others would join the slow group first.
        while n == 0 && watches[0].round_trip().is_none() {
            tokio::task::yield_now().await;
        }
    }
    for watch in &watches {
        let first = next(watch).await;
        assert!(is_key_frame(&first.payload.bytes));
        for _ in 0..5 {
            assert_eq!(next(watch).await.skipped, 0);
        }
    }
    let key_frames = video_status(&camera).key_frames;
    assert!(key_frames <= 5, "{key_frames} key frames");
}

fn video_status(camera: &Camera) -> rect_core::stream::status::VideoStatus {
    let status = camera.stream.status();
    let video = status.groups.first().and_then(|group| group.video.clone());
    video.expect("a video")
}
