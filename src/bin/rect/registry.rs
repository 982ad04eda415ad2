//! Owns `rect peers` and `rect connections`.
use std::{collections::BTreeMap, process::ExitCode};

use clap::Args;
use comfy_table::{presets::NOTHING, Table};
use rect::{core::wording::milliseconds, Connection, ConnectionState, Name};
use serde_json::json;

use crate::{
    session::{name, JoinArguments},
    Done,
};

/// Show which robots of the fleet are there, and how they are linked with this one.
#[derive(Args)]
pub struct PeersArguments {
    /// As JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Show which connections a robot's router has.
#[derive(Args)]
pub struct ConnectionsArguments {
    /// Whose [default: this robot's]
    #[arg(value_parser = name)]
    robot: Option<Name>,
    /// Which, as the registry takes it: method=ble, state=connected, 'peer=wombat-2;method=tcp'
    #[arg(long, default_value = "")]
    which: String,
    /// As JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect peers`.
pub async fn peers(arguments: PeersArguments) -> Done {
    let robot = arguments.join.join_to_hear().await?;
    let peers = robot.peers().await?;
    // Without a registry one sees who is there all the same.
    let connections = robot.connections().await.unwrap_or_default();
    let mut linked: BTreeMap<&str, Vec<&Connection>> = BTreeMap::new();
    for one in &connections {
        let peer = one.peer.as_ref().and_then(|peer| peer.robot.as_deref());
        if let (Some(peer), ConnectionState::Connected) = (peer, one.state) {
            linked.entry(peer).or_default().push(one);
        }
    }
    if arguments.json {
        let all: Vec<_> = peers
            .iter()
            .map(|peer| json!({ "robot": peer, "links": linked.get(peer.as_str()) }))
            .collect();
        println!("{:#}", serde_json::Value::from(all));
        return Ok(ExitCode::SUCCESS);
    }
    if peers.is_empty() {
        println!("no other robot of the fleet {} is there", robot.fleet());
        return Ok(ExitCode::SUCCESS);
    }
    let mut table = table(["ROBOT", "LINKED BY", "ROUND TRIP", "SIGNAL"]);
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
        let by = if links.is_empty() {
            "another robot".to_owned()
        } else {
            each(|link| Some(link.method.clone()))
        };
        let round_trip = each(|link| link.round_trip_ms.map(milliseconds));
        let signal = each(|link| link.rssi_dbm.map(|dbm| format!("{dbm} dBm")));
        table.add_row([peer.to_string(), by, round_trip, signal]);
    }
    println!("{table}");
    Ok(ExitCode::SUCCESS)
}

/// `rect connections`.
pub async fn connections(arguments: ConnectionsArguments) -> Done {
    let robot = arguments.join.join_to_hear().await?;
    let whose = arguments.robot.unwrap_or_else(|| robot.name().clone());
    let connections = robot.connections_of(&whose, &arguments.which).await?;
    if arguments.json {
        println!("{:#}", serde_json::to_value(&connections)?);
        return Ok(ExitCode::SUCCESS);
    }
    let mut table = table([
        "NAME",
        "METHOD",
        "ADDRESS",
        "STATE",
        "PEER",
        "ROUND TRIP",
        "LAST ERROR",
    ]);
    for one in &connections {
        let peer = one.peer.as_ref();
        let peer = peer.map(|peer| peer.robot.clone().unwrap_or_else(|| peer.id.clone()));
        let round_trip = one.round_trip_ms.map(milliseconds);
        let trouble = one.last_error.as_ref().map(|trouble| trouble.what.clone());
        let state = match one.state {
            ConnectionState::Connected => "connected",
            ConnectionState::Connecting => "connecting",
            ConnectionState::Discovered => "discovered",
        };
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
        table.add_row([
            or_dash(one.name.clone()),
            one.method.clone(),
            one.address.clone(),
            state.to_owned(),
            or_dash(peer),
            or_dash(round_trip),
            or_dash(trouble),
        ]);
    }
    println!("{table}");
    Ok(ExitCode::SUCCESS)
}

fn table<const N: usize>(columns: [&str; N]) -> Table {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_header(columns);
    table
}
