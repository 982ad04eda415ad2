//! Parses untrusted lists of connections. The parser must accept a list completely, or return one error with its
//! position in the text.
use rect_connections::file::{parse, Limits};

const MAX_CONNECTIONS: usize = 8;

fn limits() -> Limits {
    Limits {
        robot: "me".to_owned(),
        max_connections: MAX_CONNECTIONS,
        option_folders: vec!["/etc/rect".into()],
    }
}

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else {
        return;
    };
    match parse(text, &limits()) {
    Ok(list) => {
        assert!(list.connections.len() <= MAX_CONNECTIONS);
        for spec in list.connections {
            assert!(!spec.name.is_empty() && spec.endpoint.protocol().as_str() == spec.method);
        }
    }
    Err(error) => {
        let lines = text.matches('\n').count() + 1;
        assert!(
            (1..=lines).contains(&error.line) && error.column >= 1,
            "{error}"
        );
    }
}
}
