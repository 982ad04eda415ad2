//! Defines the link contract: the tests that every radio must pass. `sim/link_contract.rs` runs it on the simulated air in
//! virtual time, `contract_bluez.rs` on the Bluetooth stack of the kernel (in the VM: `tests/vm/test`).
pub mod channel;
pub mod closing;
pub mod compression;
pub mod flooding;
pub mod handshake;
pub mod handshake_flood;
pub mod link;
pub mod misbehaving;
pub mod secret;

use std::sync::Arc;

use futures::future::BoxFuture;
use zenoh_link_ble_radio::{address::Psm, Channel, ChannelListener, ChannelOptions, Radio};

use crate::shared::{listener::OPTIONS, peer::within};

/// Two radios in range of each other.
pub struct World {
    pub a: Arc<dyn Radio>,
    pub b: Arc<dyn Radio>,
    /// Drops all connections between them, as if they went out of range, without a message from either side.
    pub lose_links: Box<dyn Fn() + Send + Sync>,
    /// Returns whether there is a connection between them, with or without channels.
    pub is_connected: Box<dyn Fn() -> BoxFuture<'static, bool> + Send + Sync>,
    /// Limits the rate of both radios, in bytes per second; 0: no limit. The simulated air always has its own rate.
    pub set_pace: Box<dyn Fn(u32) + Send + Sync>,
    /// Whether the time is virtual: a busy computer misses nothing.
    pub is_simulated: bool,
}

/// Limits the rate of both radios of a world while it lives.
pub struct Paced<'a>(&'a World);

impl<'a> Paced<'a> {
    pub fn new(world: &'a World, bytes_per_s: u32) -> Self {
        (world.set_pace)(bytes_per_s);
        Self(world)
    }
}

impl Drop for Paced<'_> {
    fn drop(&mut self) {
        (self.0.set_pace)(0);
    }
}

/// Returns the advertisement of a test listener.
pub fn advertisement(psm: Psm, name: &str) -> zenoh_link_ble_radio::advertisement::Advertisement {
    zenoh_link_ble_radio::advertisement::Advertisement {
        psm,
        plain: false,
        name_hash: zenoh_link_ble_radio::advertisement::Advertisement::hash_of_name(name),
        fleet_hash: 0,
        incarnation: 1,
    }
}

/// Opens a channel from `a` to a listener on `b`. Returns both ends and the listener.
pub async fn channel_pair(
    world: &World,
) -> (Arc<dyn Channel>, Arc<dyn Channel>, Box<dyn ChannelListener>) {
    channel_pair_with(world, OPTIONS).await
}

/// Opens a channel as [`channel_pair`] does, with the given options.
pub async fn channel_pair_with(
    world: &World,
    options: ChannelOptions,
) -> (Arc<dyn Channel>, Arc<dyn Channel>, Box<dyn ChannelListener>) {
    let listener = within("listening", world.b.listen(None, options))
        .await
        .expect("listens");
    let _advertising = world
        .b
        .advertise(&advertisement(listener.psm(), "b"), "b")
        .await
        .expect("advertises");
    let to = world.b.address().await.expect("has an address");
    let (near, far) = within("connecting", async {
        tokio::join!(
            world.a.connect(to, listener.psm(), options),
            listener.accept()
        )
    })
    .await;
    (near.expect("connects"), far.expect("accepts"), listener)
}

/// Runs every scenario of the contract through `$run!(name, path)`.
#[macro_export]
macro_rules! for_each_scenario {
    ($run:ident) => {
        $run! {
            reports_an_advertisement_unchanged_and_repeatedly: channel,
            scan_starts_after_cancelled_scans: channel,
            delivers_sdus_of_every_size_in_order_in_both_directions: channel,
            waiting_for_room_costs_few_attempts: channel,
            closing_a_channel_ends_the_peers_receive: channel,
            dropping_a_channel_ends_the_peers_receive: channel,
            channel_stays_down_after_repeated_calls: channel,
            refuses_a_psm_without_a_listener: channel,
            refuses_a_second_listener_on_a_psm: channel,
            connects_after_cancelled_connects: channel,
            supports_several_channels_between_two_radios: channel,
            can_send_immediately_after_connect: channel,
            pairs_two_unknown_devices_for_an_encrypted_channel: channel,
            refuses_an_sdu_above_the_channels_limit: channel,
            connection_stays_open_until_it_is_closed: channel,
            dials_by_name_and_delivers_batches_in_both_directions: link,
            dials_by_address: link,
            two_nodes_that_dial_each_other_make_one_link: link,
            reconnects_after_a_close_by_either_side: link,
            delivers_batches_sent_before_close: link,
            an_empty_write_does_not_end_the_link: link,
            uses_the_smaller_mtu_of_both_sides: link,
            error_names_a_peer_that_does_not_advertise: link,
            rejects_a_second_listener_with_the_same_name: link,
            listener_can_be_deleted_and_started_again: link,
            delivers_declarations_in_order_in_both_directions: compression,
            compresses_declarations_alone_and_only_for_a_peer_that_accepts_that: compression,
            compressed_batch_that_cannot_be_restored_ends_the_link: compression,
            dialler_closes_the_connection_after_the_peer_has_ended_the_link: closing,
            dialler_closes_the_connection_after_a_refusal: closing,
            side_that_ends_a_link_closes_its_connection: closing,
            listener_closes_the_connection_of_a_peer_that_it_refuses: closing,
            connection_stays_open_while_another_link_uses_it: closing,
            accepts_a_plain_peer_without_a_hello: misbehaving,
            mtu_of_a_plain_link_is_limited_by_the_channel: handshake,
            refuses_an_invalid_hello_with_the_reason: handshake,
            answers_a_later_version_with_its_own_version: handshake,
            delivers_a_batch_sent_before_the_accept: handshake,
            zenoh_handshake_on_another_lane_ends_the_link: misbehaving,
            accepts_all_lanes_after_the_zenoh_handshake: misbehaving,
            replaced_link_reports_the_replacement_on_both_sides: misbehaving,
            accepts_a_robot_despite_silent_channels: handshake_flood,
            closed_channel_releases_its_handshake_immediately: handshake_flood,
            drops_garbage_and_silent_peers_without_affecting_others: misbehaving,
            dial_fails_on_an_invalid_or_missing_response: misbehaving,
            oversize_batch_ends_the_link: misbehaving,
            repeated_sdu_ends_the_link: misbehaving,
            skipped_sdu_ends_the_link: misbehaving,
            malformed_sdu_ends_the_link: misbehaving,
            acknowledging_unsent_data_ends_the_link: misbehaving,
            decreasing_acknowledgement_ends_the_link: misbehaving,
            ignores_data_after_a_goodbye: misbehaving,
            close_completes_if_the_peer_keeps_sending: misbehaving,
            bounds_an_unread_lane_of_a_flooding_peer: flooding,
            delivers_everything_from_full_lanes: flooding,
            links_two_nodes_with_the_same_secret: secret,
            dials_with_the_secret_of_its_listener: secret,
            refuses_links_without_the_secret_in_both_directions: secret,
            rejects_an_impostor_with_the_name_of_a_robot: secret,
            refuses_a_replayed_handshake: secret,
            refuses_anything_but_a_sealed_hello: secret,
            refuses_an_invalid_sealed_hello_with_the_reason: secret,
            accepts_no_other_version_of_a_key_answer: secret,
            refuses_a_hello_without_keys: secret,
            forged_sdu_ends_an_encrypted_link: secret,
            does_not_dial_a_plain_listener_with_a_secret: secret,
            sec_high_requires_a_secret: secret,
        }
    };
}
