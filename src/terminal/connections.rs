//! Renders the connections of the registry as a table.
use super::{Cell, Style, Table};
use crate::core::{
    connection::{Connection, ConnectionState as State},
    humanize::{bytes, duration_of_s, milliseconds, short_reason},
};

/// Returns a table of the connections of several robots, each given with its name.
pub fn connections_of_robots<'a>(
    robots: impl IntoIterator<Item = (&'a str, &'a [Connection])>,
) -> Table {
    let columns: Vec<_> = std::iter::once("ROBOT").chain(COLUMNS).collect();
    let mut table = Table::new(&columns);
    for (robot, connections) in robots {
        for one in connections {
            let mut cells = vec![robot.into()];
            cells.extend(row(one));
            add(&mut table, cells, one);
        }
    }
    table
}

/// Returns a table of the connections of one robot.
pub fn connections_of_robot(connections: &[Connection]) -> Table {
    let mut table = Table::new(&COLUMNS);
    for one in connections {
        add(&mut table, row(one).into(), one);
    }
    table
}

const COLUMNS: [&str; 10] = [
    "NAME",
    "METHOD",
    "ADDRESS",
    "STATE",
    "PEER",
    "?ROUND TRIP",
    "?SIGNAL",
    "?UP",
    "?SENT",
    "?RECEIVED",
];

fn add(table: &mut Table, cells: Vec<Cell>, one: &Connection) {
    table.row(cells);
    if let Some(trouble) = &one.last_error {
        let ago = duration_of_s(trouble.ago_s);
        table.note(&format!(
            "last error, {ago} ago: {}",
            short_reason(&trouble.what)
        ));
    }
}

fn row(one: &Connection) -> [Cell; 10] {
    let state = match one.state {
        State::Connected => Cell::styled(Style::Good, "connected"),
        State::Connecting => Cell::styled(Style::Poor, "connecting"),
        State::Discovered => Cell::styled(Style::Faint, "discovered"),
    };
    let peer = one.peer.as_ref().map(|peer| match &peer.robot {
        Some(robot) => robot.clone(),
        // The first 8 characters of the id suffice to distinguish programs and routers.
        None => peer.id.chars().take(8).collect(),
    });
    [
        one.name.clone().into(),
        one.method.as_str().into(),
        one.address.as_str().into(),
        state,
        peer.into(),
        one.round_trip_ms.map(milliseconds).into(),
        one.rssi_dbm.map(|dbm| format!("{dbm} dBm")).into(),
        one.up_s.map(duration_of_s).into(),
        one.sent.map(|sent| bytes(sent.bytes)).into(),
        one.received.map(|received| bytes(received.bytes)).into(),
    ]
}
