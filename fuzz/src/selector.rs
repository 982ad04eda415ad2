//! Parses untrusted selectors of registry queries. A rejected selector must have an error text.
use rect_core::registry::selector::Selector;
use zenoh_protocol::core::Parameters;

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else {
        return;
    };
    if let Err(error) = Selector::parse(Parameters::from(text).iter()) {
        assert!(!error.is_empty());
    }
}
