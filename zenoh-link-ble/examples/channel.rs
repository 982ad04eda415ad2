//! Measures a bare LE L2CAP channel between two adapters, without Zenoh, for benchmarks and experiments.
//!
//! ```text
//! channel serve hci1                     # accepts channels; answers SDUs of 20 bytes and the last SDU of a flood
//! channel ping  hci0 ADDRESS 200         # 200 round trips of 20-byte SDUs
//! channel flood hci0 ADDRESS 500000 4000 # goodput of 500000 bytes in SDUs of 4000 bytes
//! # The same, with an SDU of 16 bytes every 50 ms that is not counted. It must not have 20 bytes, which are answered.
//! channel flood hci0 ADDRESS 500000 4000 16 50
//! ```
//! Adapters named `sim-...` use the simulated air. The result is one line of JSON.
use std::{
    error::Error,
    sync::Arc,
    time::{Duration, Instant},
};

use zenoh_link_ble::locator::is_simulated;
use zenoh_link_ble_radio::{
    address::{Address, Psm},
    advertisement::Advertisement,
    Channel, ChannelOptions, Radio, RadioError, Security,
};

const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 16_384,
    security: Security::Low,
    passkey: None,
};
const PING_BYTES: usize = 20;
const USAGE: &str = "usage: channel serve ADAPTER | ping ADAPTER ADDRESS COUNT | \
    flood ADAPTER ADDRESS BYTES SDU_BYTES [SMALL_BYTES EVERY_MS]";
const NAME: &str = "channel-example";
/// First byte of the last SDU of a flood, which the server answers.
const LAST: u8 = 1;

type Outcome = Result<(), Box<dyn Error>>;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["serve", adapter] => serve(radio(adapter)?).await,
        ["ping", adapter, peer, count] => {
            ping(dial(radio(adapter)?, peer).await?, count.parse()?).await
        }
        ["flood", adapter, peer, bytes, sdu, rest @ ..] => {
            let small_sdus = match rest {
                [] => None,
                [small, ms] => Some((small.parse()?, Duration::from_millis(ms.parse()?))),
                _ => return Err(USAGE.into()),
            };
            flood(
                dial(radio(adapter)?, peer).await?,
                bytes.parse()?,
                sdu.parse()?,
                small_sdus,
            )
            .await
        }
        _ => Err(USAGE.into()),
    }
}

fn radio(name: &str) -> Result<Arc<dyn Radio>, Box<dyn Error>> {
    Ok(if is_simulated(name) {
        zenoh_link_ble_air::radio(name)?
    } else {
        zenoh_link_ble_bluez::radio(Some(name))?
    })
}

async fn serve(radio: Arc<dyn Radio>) -> Outcome {
    let listener = radio.listen(None, OPTIONS).await?;
    let advertisement = Advertisement {
        psm: listener.psm(),
        plain: true,
        name_hash: Advertisement::hash_of_name(NAME),
        fleet_hash: 0,
        incarnation: 0,
    };
    let _advertising = radio.advertise(&advertisement, NAME).await?;
    println!("{{\"address\":\"{}\"}}", radio.address().await?);
    loop {
        let channel = listener.accept().await?;
        tokio::spawn(async move {
            let mut sdu = vec![0; usize::from(OPTIONS.recv_mtu)];
            while let Ok(size) = channel.recv(&mut sdu).await {
                let answer = size == PING_BYTES || sdu.first() == Some(&LAST);
                if answer && channel.send(&sdu[..PING_BYTES.min(size)]).await.is_err() {
                    return;
                }
            }
        });
    }
}

async fn dial(radio: Arc<dyn Radio>, peer: &str) -> Result<Arc<dyn Channel>, Box<dyn Error>> {
    let address: Address = peer.parse()?;
    let (device, psm) =
        tokio::time::timeout(Duration::from_secs(20), find(&radio, address)).await??;
    let connected = radio.connect(device, psm, OPTIONS);
    Ok(tokio::time::timeout(Duration::from_secs(20), connected).await??)
}

async fn find(
    radio: &Arc<dyn Radio>,
    address: Address,
) -> Result<(zenoh_link_ble_radio::address::DeviceAddress, Psm), RadioError> {
    let mut scan = radio.scan().await?;
    loop {
        let report = scan.next().await?;
        let is_peer = report.device.address == address;
        if let (true, Some(advertisement)) = (is_peer, report.advertisement) {
            return Ok((report.device, advertisement.psm));
        }
    }
}

async fn ping(channel: Arc<dyn Channel>, count: usize) -> Outcome {
    let mut times_ms = Vec::with_capacity(count);
    let mut buffer = [0; 100];
    for _ in 0..count {
        let start = Instant::now();
        channel.send(&[0; PING_BYTES]).await?;
        channel.recv(&mut buffer).await?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[((count - 1) as f64 * share) as usize];
    println!(
        "{{\"count\":{count},\"p50_ms\":{:.3},\"p99_ms\":{:.3}}}",
        at(0.5),
        at(0.99)
    );
    Ok(())
}

async fn flood(
    channel: Arc<dyn Channel>,
    bytes: usize,
    sdu_bytes: usize,
    small_sdus: Option<(usize, Duration)>,
) -> Outcome {
    let sdu_bytes = sdu_bytes.clamp(PING_BYTES + 1, channel.send_mtu());
    let sdus = bytes.div_ceil(sdu_bytes);
    let mut sdu = vec![0; sdu_bytes];
    let start = Instant::now();
    let mut due = start;
    for n in 1..=sdus {
        if let Some((small_bytes, interval)) = small_sdus.filter(|_| due <= Instant::now()) {
            channel.send(&vec![0; small_bytes]).await?;
            due += interval;
        }
        sdu[0] = if n == sdus { LAST } else { 0 };
        channel.send(&sdu).await?;
    }
    channel.recv(&mut [0; 100]).await?;
    let seconds = start.elapsed().as_secs_f64();
    let sent = sdus * sdu_bytes;
    println!(
        "{{\"bytes\":{sent},\"sdu_bytes\":{sdu_bytes},\"seconds\":{seconds:.3},\"kb_per_s\":{:.2}}}",
        sent as f64 / seconds / 1e3
    );
    Ok(())
}
