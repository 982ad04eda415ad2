//! The link contract: what must hold on every radio. `contract_sim.rs` runs it on the simulated air in virtual time,
//! `contract_bluez.rs` on the kernel's own stack (in the VM: `tests/vm/test`).
pub mod channel;
pub mod flooding;
pub mod handshake;
pub mod link;
pub mod misbehaving;
pub mod occupying;
pub mod secret;

use std::sync::Arc;

use zenoh_link_ble::{
    address::Psm,
    radio::{Channel, ChannelListener, ChannelOptions, Radio},
};

use crate::shared::{listener::OPTIONS, peer::within};

/// Two radios in range of each other.
pub struct World {
    pub a: Arc<dyn Radio>,
    pub b: Arc<dyn Radio>,
    /// Ends what connects them as going out of range does, without a word of either side.
    pub lose_links: Box<dyn Fn() + Send + Sync>,
}

/// An advertisement of a test listener.
pub fn advertisement(psm: Psm, name: &str) -> zenoh_link_ble::advertisement::Advertisement {
    zenoh_link_ble::advertisement::Advertisement {
        psm,
        plain: false,
        name_hash: zenoh_link_ble::advertisement::Advertisement::hash_of_name(name),
        fleet_hash: 0,
        incarnation: 1,
    }
}

/// A channel from `a` to a listener on `b`, and its other end.
pub async fn channel_pair(
    world: &World,
) -> (Arc<dyn Channel>, Arc<dyn Channel>, Box<dyn ChannelListener>) {
    channel_pair_with(world, OPTIONS).await
}

/// The same with options.
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
            an_advertisement_is_seen_as_it_was_sent_and_seen_again: channel,
            a_scan_given_up_while_it_starts_leaves_nothing_behind: channel,
            sdus_of_every_size_arrive_whole_and_in_order_both_ways: channel,
            a_closed_channel_ends_the_peers_receive: channel,
            a_dropped_channel_ends_the_peers_receive: channel,
            a_channel_that_is_down_says_so_however_often_it_is_asked: channel,
            a_psm_without_a_listener_refuses: channel,
            a_psm_is_taken_once: channel,
            a_connect_that_is_given_up_leaves_nothing_behind: channel,
            several_channels_live_side_by_side: channel,
            a_connect_that_returns_can_send_at_once: channel,
            two_strangers_pair_where_the_channel_must_be_encrypted: channel,
            an_sdu_over_the_channels_limit_is_refused: channel,
            a_peer_is_found_by_name_and_batches_go_both_ways: link,
            a_peer_is_found_by_address: link,
            two_nodes_that_dial_each_other_at_once_make_one_link: link,
            a_link_opens_again_after_it_was_closed: link,
            a_link_waits_until_zenoh_let_the_ended_one_go_and_computed_its_routes: link,
            what_was_sent_before_close_arrives: link,
            an_empty_write_is_no_end_of_the_link: link,
            the_smaller_mtu_of_both_sides_counts: link,
            a_name_nobody_advertises_is_an_error_that_names_it: link,
            a_second_node_of_the_same_name_is_told_so: link,
            a_listener_ends_when_it_is_deleted_and_can_start_again: link,
            a_plain_peer_without_hello_is_served: misbehaving,
            the_mtu_of_a_plain_link_is_its_own_and_what_the_channel_carries: handshake,
            a_hello_that_cannot_be_read_is_answered_with_the_reason: handshake,
            a_later_version_is_answered_with_the_one_spoken_here: handshake,
            what_is_sent_before_the_accept_counts_from_number_0: handshake,
            a_handshake_of_zenoh_on_another_lane_ends_the_link_with_its_reason: misbehaving,
            the_other_lanes_may_follow_the_handshake_of_zenoh_at_once: misbehaving,
            the_goodbye_of_a_replaced_link_says_so_on_both_sides: misbehaving,
            channels_that_stay_silent_do_not_keep_a_robot_waiting: occupying,
            a_channel_that_is_closed_frees_its_place_at_once: occupying,
            garbage_half_a_hello_and_silence_are_dropped_and_others_do_not_notice: misbehaving,
            a_listener_that_answers_wrongly_or_not_at_all_is_given_up: misbehaving,
            an_oversize_batch_ends_the_link_with_its_reason: misbehaving,
            a_repeated_sdu_ends_the_link_with_its_reason: misbehaving,
            a_skipped_sdu_ends_the_link_with_its_reason: misbehaving,
            an_unknown_kind_lane_or_size_ends_the_link_with_its_reason: misbehaving,
            an_acknowledgement_of_what_was_never_sent_ends_the_link: misbehaving,
            an_acknowledgement_taken_back_ends_the_link: misbehaving,
            what_comes_after_a_goodbye_is_not_delivered: misbehaving,
            a_peer_that_talks_on_after_this_sides_goodbye_does_not_hold_up_the_end: misbehaving,
            a_peer_that_floods_a_lane_nobody_reads_is_held_to_a_bound: flooding,
            a_peer_may_fill_every_lane_and_nothing_is_lost_when_they_are_read: flooding,
            two_with_the_same_secret_are_linked: secret,
            a_node_that_listens_with_a_secret_dials_with_it: secret,
            without_the_secret_there_is_no_link_in_either_direction: secret,
            a_stranger_that_takes_the_name_of_a_robot_gets_no_link: secret,
            an_opening_that_is_played_back_is_refused: secret,
            a_proof_covers_the_whole_hello: secret,
            with_a_secret_nothing_may_come_before_the_proof: secret,
            a_plain_listener_is_not_dialled_with_a_secret: secret,
            sec_high_needs_a_secret: secret,
        }
    };
}
