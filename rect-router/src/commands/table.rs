//! Owns how a table looks on a terminal.
use comfy_table::{presets::NOTHING, Table};

/// Columns under these names.
pub fn table(names: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_header(names);
    table
}

/// A number of bytes, short.
pub fn bytes(count: u64) -> String {
    match count {
        0..=9_999 => format!("{count} B"),
        10_000..=9_999_999 => format!("{} kB", count / 1_000),
        _ => format!("{} MB", count / 1_000_000),
    }
}

/// A time, short.
pub fn seconds(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6_000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_is_enough() {
        assert_eq!(
            (bytes(9_999), bytes(10_000)),
            ("9999 B".into(), "10 kB".into())
        );
        assert_eq!(bytes(12_345_678), "12 MB");
        assert_eq!(
            (seconds(12.4), seconds(300.0)),
            ("12 s".into(), "5 min".into())
        );
        assert_eq!(seconds(7_200.0), "2 h");
    }
}
