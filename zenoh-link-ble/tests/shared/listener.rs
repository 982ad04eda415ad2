//! How a test finds a listener and opens a channel to it by hand.
use std::sync::Arc;

use zenoh_link_ble::{
    address::Psm,
    radio::{ChannelOptions, Radio, Security},
};

use super::peer::within;

/// Larger than the link's MTU, so that a peer can send what is over it.
pub const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 4096,
    security: Security::Low,
    passkey: None,
};
/// Returns the PSM that a listener advertises.
pub async fn psm_of(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>) -> Psm {
    let to = to.address().await.expect("has an address");
    let mut scan = from.scan().await.expect("scans");
    within("seeing the listener", async {
        loop {
            let sighting = scan.next().await.expect("goes on scanning");
            if let (true, Some(advertisement)) = (sighting.device == to, sighting.advertisement) {
                return advertisement.psm;
            }
        }
    })
    .await
}
