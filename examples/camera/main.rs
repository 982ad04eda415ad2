//! Camera: sends pictures as a stream. Their size and quality adapt to the link: large over Wi-Fi, small over Bluetooth.
//!
//!     cargo run --example camera -- wombat-1              # sends pictures
//!     cargo run --example camera -- laptop wombat-1       # receives them
use std::time::Duration;

use rect::{codec::Limits, Format, Picture, StreamOptions};

const SIZE: (u32, u32) = (320, 240);

/// Returns the pixels of a simulated camera: a bright ball that circles in front of a grey wall.
fn take_picture(n: u32) -> Vec<u8> {
    let (width, height) = SIZE;
    let angle = f64::from(n) / 10.0;
    let (x, y) = (160.0 + 80.0 * angle.cos(), 120.0 + 80.0 * angle.sin());
    let pixel = |at: u32| {
        let (column, row) = (f64::from(at % width), f64::from(at / width));
        match (column - x).hypot(row - y) {
            distance if distance < 20.0 => [250, 200, 30],
            _ => [90, 90, 90 + (row / 4.0) as u8],
        }
    };
    (0..width * height).flat_map(pixel).collect()
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut names = std::env::args().skip(1);
    let me = names.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    if let Some(other) = names.next() {
        let camera = robot.watch(format!("{other}/camera").as_str()).await?;
        while let Some(frame) = camera.next().await {
            let picture = frame.payload.picture(&Limits::default())?;
            let (width, height) = (picture.width(), picture.height());
            let (number, age, skipped) = (frame.number, frame.age, frame.skipped);
            println!("frame {number}: {width}x{height}, {age:?} old, {skipped} frames skipped");
        }
        return Ok(());
    }
    let camera = robot.stream("camera", StreamOptions::default()).await?;
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    for n in 0.. {
        ticks.tick().await;
        let picture = Picture::new(SIZE.0, SIZE.1, Format::Rgb8, take_picture(n))?;
        camera.send_picture(&picture)?;
    }
    Ok(())
}
