//! Parses untrusted selectors of registry queries. A rejected selector must have an error text.
use rect_router::registry::selector::Selector;
use zenoh::query::Parameters;

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else {
        return;
    };
    if let Err(error) = Selector::parse(&Parameters::from(text)) {
        assert!(!error.is_empty());
    }
}
