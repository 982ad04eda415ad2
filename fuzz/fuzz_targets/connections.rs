//! Parses untrusted lists of connections. The parser must accept a list completely, or return one error with its
//! position in the text.
#![no_main]
use libfuzzer_sys::fuzz_target;
use rect_router::connections::file::{parse, Limits};

const MAX_CONNECTIONS: usize = 8;

fn limits() -> Limits {
    Limits {
        robot: "me".to_owned(),
        max_connections: MAX_CONNECTIONS,
    }
}

fuzz_target!(|text: &str| match parse(text, &limits()) {
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
});
