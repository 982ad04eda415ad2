//! The log: as zenohd's, on stdout, steered by `RUST_LOG`.

use std::env::{self, VarError};

use tracing_subscriber::EnvFilter;

/// All of zenoh (its targets begin with `z`) and of RECT, from `info` up.
const DEFAULT_FILTER: &str = "z=info,rect=info";

/// Starts logging, before anything can have something to say.
pub fn start() -> Result<(), BadFilter> {
    let given = match env::var("RUST_LOG") {
        Ok(given) => given,
        Err(VarError::NotPresent) => DEFAULT_FILTER.to_owned(),
        Err(VarError::NotUnicode(given)) => given.to_string_lossy().into_owned(),
    };
    let filter = EnvFilter::try_new(&given).map_err(|source| BadFilter { given, source })?;
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_thread_ids(true)
        .with_thread_names(true)
        .init();
    Ok(())
}

/// `RUST_LOG` can't be read: give it as `info`, or as `zenoh=debug,rect=info`.
#[derive(Debug, thiserror::Error)]
#[error("RUST_LOG={given} is not a log filter; use for example RUST_LOG=info or RUST_LOG=zenoh=debug,rect=info")]
pub struct BadFilter {
    given: String,
    source: tracing_subscriber::filter::ParseError,
}
