//! Describes the progress of a transfer.

/// The progress of a transfer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Number of bytes that the receiver has received.
    pub received_bytes: u64,
    /// Total size of the transfer, in bytes.
    pub size_bytes: u64,
}

impl Progress {
    /// Returns the progress as a fraction from 0 to 1. An empty transfer is complete.
    pub fn fraction(self) -> f64 {
        if self.size_bytes == 0 {
            return 1.0;
        }
        self.received_bytes as f64 / self.size_bytes as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_transfer_is_complete() {
        let of = |received_bytes, size_bytes| {
            Progress {
                received_bytes,
                size_bytes,
            }
            .fraction()
        };
        assert_eq!(
            (of(0, 0), of(0, 4), of(1, 4), of(4, 4)),
            (1.0, 0.0, 0.25, 1.0)
        );
    }
}
