//! Implements `rect peers` and `rect connections`.
use std::{collections::BTreeMap, process::ExitCode};

use clap::Args;
use rect::{Connection, ConnectionState, Event, Name, Robot};
use rect_core::text::humanize::{duration, duration_of_s, milliseconds};
use rect_terminal::{self as terminal, connections_of_robot, Cell, Style, Table};
use serde_json::json;

use crate::{
    duration::DurationArgument,
    session::{name, JoinArguments},
    Done,
};

/// List the reachable robots of the fleet, and how they are linked with this one
#[derive(Args)]
pub struct PeersArguments {
    /// Wait until this robot is reachable, then list
    #[arg(long, value_name = "ROBOT", value_parser = name)]
    wait: Option<Name>,
    /// Wait until this robot is no longer reachable, then list
    #[arg(long, value_name = "ROBOT", value_parser = name, conflicts_with = "wait")]
    wait_lost: Option<Name>,
    /// How long --wait and --wait-lost wait
    #[arg(long, value_name = "TIME", default_value = "30s")]
    timeout: DurationArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// List the connections of a robot's router
#[derive(Args)]
pub struct ConnectionsArguments {
    /// The robot of the router [default: this robot]
    #[arg(value_parser = name)]
    robot: Option<Name>,
    /// List only connections that match, such as method=ble, state=connected, 'peer=wombat-2;method=tcp'
    #[arg(long, default_value = "")]
    filter: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect peers`.
pub async fn peers(arguments: PeersArguments) -> Done {
    let robot = arguments.join.join_unnamed().await?;
    let DurationArgument(timeout) = arguments.timeout;
    if let Some(peer) = arguments.wait {
        robot.wait_for_peer(peer, timeout).await?;
    }
    if let Some(peer) = arguments.wait_lost {
        let lost = wait_until_lost(&robot, &peer);
        tokio::time::timeout(timeout, lost)
            .await
            .map_err(|_| format!("{peer} is still reachable after {}", duration(timeout)))??;
    }
    let peers = robot.peers().await?;
    // Without a registry, the robots are listed without their links.
    let connections = robot.connections().await.unwrap_or_default();
    let mut linked: BTreeMap<&str, Vec<&Connection>> = BTreeMap::new();
    for connection in &connections {
        if let (Some(peer), ConnectionState::Connected) = (connection.robot(), connection.state) {
            linked.entry(peer).or_default().push(connection);
        }
    }
    if arguments.json {
        let all: Vec<_> = peers
            .iter()
            .map(|peer| json!({ "robot": peer, "links": linked.get(peer.as_str()) }))
            .collect();
        terminal::json(&all)?;
        return Ok(ExitCode::SUCCESS);
    }
    if peers.is_empty() {
        rect_terminal::outln!("no other robot of the fleet {} is reachable", robot.fleet());
        return Ok(ExitCode::SUCCESS);
    }
    let mut table = Table::new(&["ROBOT", "LINKED BY", "ROUND TRIP", "SIGNAL", "?SILENT FOR"]);
    for peer in &peers {
        let links = linked.get(peer.as_str()).cloned().unwrap_or_default();
        let each = |of: fn(&Connection) -> Option<String>| {
            let all: Vec<_> = links.iter().filter_map(|link| of(link)).collect();
            if all.is_empty() {
                "-".to_owned()
            } else {
                all.join(", ")
            }
        };
        let methods = if links.is_empty() {
            "another robot".to_owned()
        } else {
            each(|link| Some(link.method.clone()))
        };
        let round_trip = each(|link| link.round_trip_ms.map(milliseconds));
        let signal = each(|link| link.rssi_dbm.map(|dbm| format!("{dbm} dBm")));
        // A robot of which nothing arrives is listed until its session ends, which takes longer over Bluetooth.
        let is_silent = !links.is_empty() && links.iter().all(|link| link.silent_s.is_some());
        let silent = links.iter().filter_map(|link| link.silent_s);
        let silent = silent.reduce(f64::min).filter(|_| is_silent);
        let silent = silent.map_or_else(
            || "".into(),
            |silent| Cell::styled(Style::Wrong, duration_of_s(silent)),
        );
        table.row(vec![
            peer.as_str().into(),
            methods.into(),
            round_trip.into(),
            signal.into(),
            silent,
        ]);
    }
    table.print();
    Ok(ExitCode::SUCCESS)
}

/// Returns when `peer` is not reachable.
async fn wait_until_lost(robot: &Robot, peer: &Name) -> Result<(), rect::Error> {
    // Before the list of robots is read, so that no change between the two is missed.
    let events = robot.events().await?;
    if !robot.peers().await?.contains(peer) {
        return Ok(());
    }
    while let Some(event) = events.next().await {
        if matches!(&event, Event::PeerDown { robot } if robot == peer) {
            return Ok(());
        }
    }
    Err(rect::Error::Closed)
}

/// Runs `rect connections`.
pub async fn connections(arguments: ConnectionsArguments) -> Done {
    let robot = arguments.join.join_unnamed().await?;
    let owner = arguments.robot.unwrap_or_else(|| robot.name().clone());
    let connections = robot.connections_of(&owner, &arguments.filter).await?;
    if arguments.json {
        terminal::json(&connections)?;
        return Ok(ExitCode::SUCCESS);
    }
    connections_of_robot(&connections).print();
    Ok(ExitCode::SUCCESS)
}
