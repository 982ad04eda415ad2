//! Parses values that have one of a few names, which the completion scripts of shells contain.
use std::{error::Error, fmt::Display, str::FromStr};

use clap::builder::{PossibleValuesParser, TypedValueParser};

/// Returns the parser of a value that is one of `all`.
pub fn of<T>(all: &[T]) -> impl TypedValueParser<Value = T>
where
    T: Display + FromStr<Err: Error + Send + Sync> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(all.iter().map(T::to_string)).try_map(|name| name.parse())
}
