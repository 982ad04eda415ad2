//! The tasks of the paths: each moves frames between the link and its medium until the path has ended.
use std::{io, sync::Arc};

use link_lanes::lanes::Lane;
use snow::StatelessTransportState;
use tokio::{
    io::{AsyncRead, AsyncWrite, AsyncWriteExt, BufReader},
    time::Instant,
};
use zenoh_link_ble::path::BlePath;

use crate::{
    connection::{open_next, seal, Connection, MAX_TCP_FRAME},
    frame::Frame,
    multipath::LAST_COPIED_LANE,
    path::Medium,
    shared::{Next, PathGuard, Shared},
};

/// Number of bytes of frames that are written at once.
const WRITE_BYTES: usize = 65_536;
/// Carries frames over a Bluetooth path until it has ended.
pub(crate) async fn run_ble(shared: Arc<Shared>, path: BlePath, is_proven: bool) {
    let guard = shared.add_path(Medium::Bluetooth, path.max_frame(), is_proven, None);
    let reason = tokio::select! {
        reason = send_ble(&guard, &path) => reason,
        reason = receive_ble(&guard, &path) => reason,
        () = guard.task.end.cancelled() => "another robot may need its place".to_owned(),
        () = shared.ended() => "the link has ended".to_owned(),
    };
    drop(guard);
    tracing::info!(
        "any: the Bluetooth path to {} has ended: {reason}",
        shared.peer
    );
    path.close().await;
}

async fn send_ble(guard: &PathGuard, path: &BlePath) -> String {
    let mut frame = Vec::new();
    let mut offer = guard.shared.own_offer();
    offer.mark_changed();
    let urgent = Lane::new(LAST_COPIED_LANE).unwrap_or(Lane::first());
    loop {
        if offer.has_changed().unwrap_or(false) {
            frame.clear();
            Frame::Offer(&offer.borrow_and_update()).encode(&mut frame);
            if let Err(error) = path.send(Lane::last(), &frame).await {
                return error.to_string();
            }
        }
        // While a frame waits for the radio, only more urgent ones are added, which overtake it.
        let is_busy = path.is_busy();
        let least_urgent = if is_busy { urgent } else { Lane::last() };
        let next = guard.shared.next_frame(guard.id, least_urgent, &mut frame);
        match next {
            Next::Frame(lane) => {
                if let Err(error) = path.send(lane, &frame).await {
                    return error.to_string();
                }
            }
            Next::Wait(until) => {
                let offered = async { drop(offer.changed().await) };
                tokio::select! {
                    () = guard.task.waker.notified() => {}
                    () = sleep_until(until) => {}
                    () = path.sent(), if is_busy => {}
                    () = offered => offer.mark_changed(),
                }
            }
        }
    }
}

async fn receive_ble(guard: &PathGuard, path: &BlePath) -> String {
    loop {
        let frame = match path.receive().await {
            Ok(frame) => frame,
            Err(error) => return error.to_string(),
        };
        if let Err(error) = guard.shared.on_frame(guard.id, &frame) {
            return error.to_string();
        }
    }
}

async fn sleep_until(until: Option<Instant>) {
    match until {
        Some(until) => tokio::time::sleep_until(until).await,
        None => std::future::pending().await,
    }
}

/// Carries frames over a TCP connection until it has ended.
pub(crate) async fn run_tcp(shared: Arc<Shared>, connection: Connection, is_proven: bool) {
    let Connection {
        read,
        write,
        keys,
        sent,
        received,
        local,
    } = connection;
    let guard = shared.add_path(Medium::Network, MAX_TCP_FRAME, is_proven, local);
    let reason = tokio::select! {
        error = send_tcp(&guard, write, &keys, sent) => error.to_string(),
        error = receive_tcp(&guard, read, &keys, received) => error.to_string(),
        () = guard.task.end.cancelled() => "it is not needed any more".to_owned(),
        () = guard.task.network_lost.cancelled() => "this side has lost the network".to_owned(),
        () = shared.ended() => "the link has ended".to_owned(),
    };
    tracing::info!(
        "any: the network path to {} has ended: {reason}",
        shared.peer
    );
}

async fn send_tcp(
    guard: &PathGuard,
    mut stream: impl AsyncWrite + Unpin,
    keys: &StatelessTransportState,
    mut number: u64,
) -> io::Error {
    let (mut frame, mut sealed) = (Vec::new(), Vec::with_capacity(WRITE_BYTES));
    let mut offer = guard.shared.own_offer();
    offer.mark_changed();
    loop {
        let next = if offer.has_changed().unwrap_or(false) {
            frame.clear();
            Frame::Offer(&offer.borrow_and_update()).encode(&mut frame);
            Next::Frame(Lane::last())
        } else {
            (guard.shared).next_frame(guard.id, Lane::last(), &mut frame)
        };
        if let Next::Frame(_) = next {
            if let Err(error) = seal(keys, number, &frame, &mut sealed) {
                return error;
            }
            number += 1;
            if sealed.len() < WRITE_BYTES - MAX_TCP_FRAME {
                continue;
            }
        }
        if !sealed.is_empty() {
            if let Err(error) = stream.write_all(&sealed).await {
                return error;
            }
            sealed.clear();
            continue;
        }
        if let Next::Wait(until) = next {
            let offered = async { drop(offer.changed().await) };
            tokio::select! {
                () = guard.task.waker.notified() => {}
                () = sleep_until(until) => {}
                () = offered => offer.mark_changed(),
            }
        }
    }
}

async fn receive_tcp(
    guard: &PathGuard,
    stream: impl AsyncRead + Unpin,
    keys: &StatelessTransportState,
    mut number: u64,
) -> io::Error {
    let mut stream = BufReader::with_capacity(WRITE_BYTES, stream);
    let (mut sealed, mut frame) = (Vec::new(), vec![0; MAX_TCP_FRAME]);
    loop {
        match open_next(&mut stream, keys, number, &mut sealed, &mut frame).await {
            Ok(size) => {
                number += 1;
                if let Err(error) = guard.shared.on_frame(guard.id, &frame[..size]) {
                    return io::Error::other(error);
                }
            }
            Err(error) => return error,
        }
    }
}
