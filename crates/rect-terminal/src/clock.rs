//! Formats the time of day in this computer's time zone.
use std::time::{SystemTime, UNIX_EPOCH};

/// Returns the time of day, such as `14:03:07.123`, in the local time zone, or in UTC if the time zone is unknown.
pub fn time_of_day(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or(i64::MAX);
    let (hours, minutes, seconds) = match local(seconds) {
        Some(time) => (time.tm_hour.into(), time.tm_min.into(), time.tm_sec.into()),
        None => {
            let of_day = seconds.rem_euclid(24 * 3600);
            (of_day / 3600, of_day / 60 % 60, of_day % 60)
        }
    };
    format!(
        "{hours:02}:{minutes:02}:{seconds:02}.{:03}",
        since.subsec_millis()
    )
}

/// Returns the date, such as `2026-11-26`, in the local time zone, or an empty text if the time zone is unknown.
pub fn date(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let time = i64::try_from(since.as_secs()).ok().and_then(local);
    time.map_or_else(String::new, |time| {
        let (year, month, day) = (1900 + time.tm_year, time.tm_mon + 1, time.tm_mday);
        format!("{year}-{month:02}-{day:02}")
    })
}

/// Returns date and time for a file name, such as `2026-11-26-14-03-07`, in the local time zone, or the seconds since 1970
/// if the time zone is unknown.
pub fn file_name(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or(i64::MAX);
    let Some(time) = local(seconds) else {
        return seconds.to_string();
    };
    let [hours, minutes, seconds] = [time.tm_hour, time.tm_min, time.tm_sec];
    format!("{}-{hours:02}-{minutes:02}-{seconds:02}", date(at))
}

/// Returns date and time in the local time zone; `None` if the system does not know it.
fn local(unix_s: i64) -> Option<libc::tm> {
    let time = libc::time_t::try_from(unix_s).ok()?;
    // SAFETY: all fields of `tm` are integers or a pointer that may be null, so zeroes are a valid value.
    let mut parts: libc::tm = unsafe { std::mem::zeroed() };
    // SAFETY: both pointers are to live values of this function, and this program changes its environment, in which the
    // function looks for the time zone, only before it starts a thread.
    let filled = unsafe { libc::localtime_r(&time, &mut parts) };
    (!filled.is_null()).then_some(parts)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn time_of_day_includes_milliseconds() {
        let shown = time_of_day(UNIX_EPOCH + Duration::from_millis(1_795_000_007_045));
        let parts: Vec<_> = shown.split([':', '.']).collect();
        assert!(matches!(parts[..], [_, _, "47", "045"]), "{shown}");
        let name = file_name(UNIX_EPOCH + Duration::from_secs(1_795_000_007));
        assert!(
            name.starts_with("2026-11-1") && name.ends_with("-47"),
            "{name}"
        );
    }
}
