//! Formats the time of day in this computer's time zone.
use std::time::{SystemTime, UNIX_EPOCH};

/// Returns the time of day, such as `14:03:07.123`, in the local time zone, or in UTC if the time zone is unknown.
pub fn time_of_day(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or(i64::MAX);
    let (hours, minutes, seconds) = local(seconds).unwrap_or_else(|| {
        let of_day = seconds.rem_euclid(24 * 3600);
        (of_day / 3600, of_day / 60 % 60, of_day % 60)
    });
    format!(
        "{hours:02}:{minutes:02}:{seconds:02}.{:03}",
        since.subsec_millis()
    )
}

/// Returns hours, minutes and seconds in the local time zone; `None` if the system does not know it.
fn local(unix_s: i64) -> Option<(i64, i64, i64)> {
    let time = libc::time_t::try_from(unix_s).ok()?;
    // SAFETY: all fields of `tm` are integers or a pointer that may be null, so zeroes are a valid value.
    let mut parts: libc::tm = unsafe { std::mem::zeroed() };
    // SAFETY: both pointers are to live values of this function, and this program never changes its environment, in which
    // the function looks for the time zone.
    let filled = unsafe { libc::localtime_r(&time, &mut parts) };
    let is_filled = !filled.is_null();
    is_filled.then(|| {
        (
            parts.tm_hour.into(),
            parts.tm_min.into(),
            parts.tm_sec.into(),
        )
    })
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
    }
}
