//! Renders the connections of the registry as a table.
use rect_core::{
    registry::connection::{
        Connection, ConnectionState as State, LinkPath, LinkPathState, PathSwitch, SwitchReason,
    },
    text::humanize::{bytes, duration_of_s, milliseconds, short_reason},
};

use crate::{Cell, Style, Table};

/// Returns a table of the connections of several robots, each given with its name.
pub fn connections_of_robots<'a>(
    robots: impl IntoIterator<Item = (&'a str, &'a [Connection])>,
) -> Table {
    let columns: Vec<_> = std::iter::once("ROBOT").chain(COLUMNS).collect();
    let mut table = Table::new(&columns);
    for (robot, connections) in robots {
        for connection in connections {
            let mut cells = vec![robot.into()];
            cells.extend(row(connection));
            add(&mut table, cells, connection);
        }
    }
    table
}

/// Returns a table of the connections of one robot.
pub fn connections_of_robot(connections: &[Connection]) -> Table {
    let mut table = Table::new(&COLUMNS);
    for connection in connections {
        add(&mut table, row(connection).into(), connection);
    }
    table
}

const COLUMNS: [&str; 11] = [
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
    "?ENCRYPTED",
];

/// Adds the row of a connection, and its last error as a note.
fn add(table: &mut Table, cells: Vec<Cell>, connection: &Connection) {
    table.row(cells);
    if let Some(paths) = &connection.paths {
        let paths: Vec<_> = paths.iter().map(path).collect();
        let switches = switches(connection);
        table.note(&format!("paths: {}{switches}", paths.join(", ")));
    }
    if let Some(waiting) = waiting(connection) {
        table.note(&waiting);
    }
    if let Some(failure) = &connection.last_error {
        let ago = duration_of_s(failure.ago_s);
        table.note(&format!(
            "last error, {ago} ago: {}",
            short_reason(&failure.what)
        ));
    }
}

/// Describes what waits on a link or was dropped, such as `waiting: Data 3.1 kB (210 ms), 2 batches dropped`.
fn waiting(connection: &Connection) -> Option<String> {
    let lanes = connection.lanes.iter().flatten();
    let waits = lanes.filter(|lane| lane.waiting_bytes > 0).map(|lane| {
        let delay = lane.delay_ms.map(milliseconds);
        let delay = delay.map_or_else(String::new, |delay| format!(" ({delay})"));
        format!("{} {}{delay}", lane.priority, bytes(lane.waiting_bytes))
    });
    let dropped = connection.dropped_batches().filter(|&count| count > 0);
    let dropped = dropped.map(|count| format!("{count} batches dropped"));
    let parts: Vec<_> = waits.chain(dropped).collect();
    (!parts.is_empty()).then(|| format!("waiting: {}", parts.join(", ")))
}

/// Describes the switches of a link, such as `; switched 3 times, 12 s ago from tcp to ble (silent for 120 ms)`. A path that carries
/// the load again after an interruption counts as a switch, too.
fn switches(connection: &Connection) -> String {
    let last = connection.last_switch.as_ref();
    let is_same = last.is_some_and(|last| last.previous == last.path);
    let times = match connection.switches {
        None | Some(0) => return String::new(),
        Some(1) => "once".to_owned(),
        Some(switches) => format!("{switches} times"),
    };
    let Some(switch) = last else {
        return format!("; switched {times}");
    };
    let (ago, gap) = (
        duration_of_s(switch.ago_s),
        duration_of_s(switch.gap_ms / 1000.0),
    );
    let PathSwitch { previous, path, .. } = switch;
    if is_same {
        let what = match connection.switches {
            Some(1) => "interrupted",
            _ => "interrupted or switched",
        };
        let why = match switch.reason {
            SwitchReason::Ended => format!("{path} had ended, and is connected again"),
            SwitchReason::Silent => {
                format!("{path} was silent for {gap}, and carries the load again")
            }
            SwitchReason::Faster => format!("another {path} path is faster"),
        };
        return format!("; {what} {times}, {ago} ago: {why}");
    }
    let why = match switch.reason {
        SwitchReason::Ended => "the path had ended".to_owned(),
        SwitchReason::Silent => format!("silent for {gap}"),
        SwitchReason::Faster => "faster".to_owned(),
    };
    format!("; switched {times}, {ago} ago from {previous} to {path} ({why})")
}

/// Describes a path, such as `tcp (bulk, 3.1 MB/s, 4 ms)`.
fn path(path: &LinkPath) -> String {
    let state = match path.state {
        LinkPathState::Live if path.is_primary => "bulk",
        LinkPathState::Live => "ready",
        LinkPathState::Suspected => "silent",
        LinkPathState::Untried => "new",
    };
    let rate = format!("{}/s", bytes(path.bytes_per_s as u64));
    let round_trip = path.round_trip_ms.map(milliseconds);
    let details = [Some(state.to_owned()), Some(rate), round_trip];
    let details: Vec<_> = details.into_iter().flatten().collect();
    format!("{} ({})", path.method, details.join(", "))
}

/// Describes for how long nothing has been received over a link.
fn silence(connection: &Connection) -> Cell {
    let silent = connection.silent_s.map(duration_of_s).unwrap_or_default();
    Cell::styled(Style::Wrong, format!("silent for {silent}"))
}

fn row(connection: &Connection) -> [Cell; 11] {
    let state = match connection.state {
        State::Connected if connection.silent_s.is_some() => silence(connection),
        State::Connected => Cell::styled(Style::Good, "connected"),
        State::Connecting => Cell::styled(Style::Poor, "connecting"),
        State::Discovered => Cell::styled(Style::Faint, "discovered"),
    };
    let peer = connection.peer.as_ref().map(|peer| match &peer.robot {
        Some(robot) => robot.clone(),
        // The first 8 characters of the id suffice to distinguish programs and routers.
        None => peer.id.chars().take(8).collect(),
    });
    [
        connection.name.clone().into(),
        connection.method.as_str().into(),
        connection.address.as_str().into(),
        state,
        peer.into(),
        connection.round_trip_ms.map(milliseconds).into(),
        connection.rssi_dbm.map(|dbm| format!("{dbm} dBm")).into(),
        connection.up_s.map(duration_of_s).into(),
        connection.sent.map(|sent| bytes(sent.bytes)).into(),
        connection
            .received
            .map(|received| bytes(received.bytes))
            .into(),
        (connection.encrypted)
            .map(|is_encrypted| if is_encrypted { "yes" } else { "no" })
            .map(str::to_owned)
            .into(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_link_is_not_shown_as_connected() {
        let mut connection = Connection::of("any", "wombat-2", State::Connected);
        connection.silent_s = Some(4.2);
        let mut table = Table::new(&COLUMNS);
        add(&mut table, row(&connection).into(), &connection);
        let shown = table.lines(None, false).join("\n");
        assert!(
            shown.contains("silent for 4.2 s") && !shown.contains("connected"),
            "{shown}"
        );
    }

    #[test]
    fn a_path_that_carries_the_load_again_is_not_a_switch_to_itself() {
        let mut connection = Connection::of("any", "wombat-2", State::Connected);
        assert_eq!(switches(&connection), "");
        connection.switches = Some(1);
        connection.last_switch = Some(PathSwitch {
            previous: "ble".to_owned(),
            path: "ble".to_owned(),
            reason: SwitchReason::Silent,
            gap_ms: 3000.0,
            ago_s: 12.0,
        });
        let shown = switches(&connection);
        assert_eq!(
            shown,
            "; interrupted once, 12 s ago: ble was silent for 3 s, and carries the load again"
        );
        connection.switches = Some(3);
        for reason in [SwitchReason::Ended, SwitchReason::Faster] {
            if let Some(last) = connection.last_switch.as_mut() {
                last.reason = reason;
            }
            let shown = switches(&connection);
            assert!(
                shown.starts_with("; interrupted or switched 3 times") && !shown.contains(" from "),
                "{shown}"
            );
        }
        if let Some(last) = connection.last_switch.as_mut() {
            last.previous = "tcp".to_owned();
        }
        assert_eq!(
            switches(&connection),
            "; switched 3 times, 12 s ago from tcp to ble (faster)"
        );
    }
}
