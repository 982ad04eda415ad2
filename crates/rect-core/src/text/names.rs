//! Lists names in words, with the one that another may be a misspelling of.

/// The similarity of two names, from 0 to 1, from which one may be a misspelling of the other.
const SIMILAR: f64 = 0.7;
/// The largest number of names in a description.
const MAX_LISTED: usize = 20;

/// Returns names in words, and the one that `name` may be a misspelling of: `did you mean arm? (its streams: arm, leg)`.
pub fn in_words<'a>(
    what: &str,
    name: &str,
    names: impl Iterator<Item = &'a str> + Clone,
) -> String {
    let count = names.clone().count();
    let listed: Vec<_> = names.clone().take(MAX_LISTED).collect();
    let listed = match listed.as_slice() {
        [] => "none".to_owned(),
        listed if count > listed.len() => {
            format!("{} and {} more", listed.join(", "), count - listed.len())
        }
        listed => listed.join(", "),
    };
    match similar(name, names) {
        Some(similar) => format!("did you mean {similar}? ({what}: {listed})"),
        None => format!("{what}: {listed}"),
    }
}

/// Returns the name that another one may be a misspelling of. The robots wombat-2 and wombat-3 are different ones.
fn similar<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let without_digits = |name: &str| name.replace(|c: char| c.is_ascii_digit(), "");
    names
        .filter(|other| without_digits(other) != without_digits(name))
        .map(|other| (strsim::jaro_winkler(name, other), other))
        .filter(|(similarity, _)| *similarity >= SIMILAR)
        .max_by(|(one, _), (other, _)| one.total_cmp(other))
        .map(|(_, other)| other)
}
