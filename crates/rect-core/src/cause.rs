//! Defines [`Cause`], the error of another library that caused one of this library.
use std::{error::Error, fmt, sync::Arc};

/// The error of another library, or a reason in words, that caused an error. Causes are equal if their texts are.
#[derive(Clone)]
pub struct Cause(Arc<dyn Error + Send + Sync>);

impl Cause {
    /// Keeps an error, or a reason in words.
    pub fn new(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self(Arc::from(error.into()))
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Debug for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Error for Cause {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.0.source()
    }
}

impl PartialEq for Cause {
    fn eq(&self, other: &Self) -> bool {
        self.to_string() == other.to_string()
    }
}

impl Eq for Cause {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_of_the_kept_error_follow_it() {
        #[derive(Debug, thiserror::Error)]
        #[error("the file is not valid")]
        struct Invalid(#[source] std::fmt::Error);

        let cause = Cause::new(Invalid(std::fmt::Error));
        assert_eq!(cause.to_string(), "the file is not valid");
        let source = cause.source().map(ToString::to_string);
        assert_eq!(source, Some(std::fmt::Error.to_string()));
        assert_eq!(cause, Cause::new("the file is not valid"));
        assert_ne!(cause, Cause::new("another reason"));
    }
}
