//! Finds a listener and its PSM, for tests that open channels directly.
use std::sync::Arc;

use zenoh_link_ble_radio::{address::Psm, ChannelOptions, Radio, Security};

use super::peer::within;

/// Options with an MTU above that of the link, so that a peer can send oversize SDUs.
pub const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 4096,
    security: Security::Low,
    passkey: None,
};

/// Returns the PSM that a listener advertises.
pub async fn psm_of(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>) -> Psm {
    let to = to.address().await.expect("has an address");
    let mut scan = from.scan().await.expect("scans");
    within("discovering the listener", async {
        loop {
            let report = scan.next().await.expect("keeps scanning");
            if let (true, Some(advertisement)) = (report.device == to, report.advertisement) {
                return advertisement.psm;
            }
        }
    })
    .await
}
