//! Owns progress: how much of a transfer is there.

/// How much of a transfer the receiver holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// What it holds.
    pub held_bytes: u64,
    /// Of how many.
    pub size_bytes: u64,
}

impl Progress {
    /// 0 to 1; of nothing, all is there.
    pub fn fraction(self) -> f64 {
        if self.size_bytes == 0 {
            return 1.0;
        }
        self.held_bytes as f64 / self.size_bytes as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_nothing_all_is_there() {
        let of = |held_bytes, size_bytes| {
            Progress {
                held_bytes,
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
