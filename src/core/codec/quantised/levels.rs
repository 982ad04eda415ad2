//! Owns levels: which whole number of steps stands for a number, and which one is to be expected after those before it.
use std::collections::VecDeque;

use super::varint;
use crate::core::array::Number;

/// Levels beyond are exceptions: up to here every whole number is an `f64`, and differences of differences fit 64 bits.
const MOST: f64 = (1u64 << 51) as f64;

/// The floats.
pub trait Float: Number {
    /// Half of the gap between two neighbours near 1: what rounding to the type may add.
    const HALF_GAP: f64;
    /// Exactly.
    fn wide(self) -> f64;
    /// The nearest.
    fn narrow(wide: f64) -> Self;
}

impl Float for f32 {
    const HALF_GAP: f64 = f32::EPSILON as f64 / 2.0;

    fn wide(self) -> f64 {
        self.into()
    }

    fn narrow(wide: f64) -> Self {
        wide as f32
    }
}

impl Float for f64 {
    const HALF_GAP: f64 = f64::EPSILON / 2.0;

    fn wide(self) -> f64 {
        self
    }

    fn narrow(wide: f64) -> Self {
        wide
    }
}

/// The step with which hardly a number is off by more than `error`: a little less than twice that, for what rounding adds.
pub fn step<T: Float>(numbers: &[T], error: f64) -> f32 {
    let sizes = numbers.iter().map(|number| number.wide().abs());
    let largest = sizes.filter(|size| size.is_finite()).fold(0.0, f64::max);
    let rounding = largest * T::HALF_GAP;
    let left = if rounding < error / 2.0 {
        error - rounding
    } else {
        error
    };
    let wanted = left * (2.0 - 1e-9);
    let step = wanted as f32;
    if f64::from(step) > wanted {
        // The next smaller one; it is positive and far from 0.
        return f32::from_bits(step.to_bits() - 1);
    }
    step
}

/// The number of a level.
pub fn number<T: Float>(level: i64, step: f32) -> T {
    T::narrow(level as f64 * f64::from(step))
}

/// The level of a number; `None`: none is near enough.
pub fn level<T: Float>(wanted: T, step: f32, error: f64) -> Option<i64> {
    let steps = (wanted.wide() / f64::from(step)).round();
    if steps.is_nan() || steps.abs() > MOST {
        return None;
    }
    let level = steps as i64;
    let off = (number::<T>(level, step).wide() - wanted.wide()).abs();
    (off <= error).then_some(level)
}

/// How a level is guessed from those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prediction {
    /// 0: it is 0; 1: it is as that before; 2: it goes on as it went.
    pub order: u8,
    /// Which one is the one before: 1, or as far as a row is long, where rows or channels look alike.
    pub distance: usize,
}

impl Prediction {
    /// The one that leaves least to say.
    pub fn best(levels: &[Option<i64>], shape: &[usize]) -> Self {
        let row = shape.last().copied().unwrap_or(1);
        let row = (1 < row && row < levels.len()).then_some(row);
        let orders = |distance| [1, 2].map(|order| Self { order, distance });
        let none = Self {
            order: 0,
            distance: 1,
        };
        let by_row = row.into_iter().flat_map(orders);
        let all = [none].into_iter().chain(orders(1)).chain(by_row);
        all.min_by_key(|prediction| prediction.bits(levels))
            .unwrap_or(none)
    }

    fn bits(self, levels: &[Option<i64>]) -> u64 {
        let mut past = Past::new(self);
        let mut bits = 0;
        for &level in levels {
            let residual = level.map_or(0, |level| level.wrapping_sub(past.prediction()));
            bits += u64::from(64 - varint::zigzag(residual).leading_zeros());
            past.push(level);
        }
        bits
    }
}

/// The levels that the next one is guessed from.
pub struct Past {
    prediction: Prediction,
    levels: VecDeque<i64>,
}

impl Past {
    /// Nothing yet.
    pub fn new(prediction: Prediction) -> Self {
        let levels = VecDeque::new();
        Self { prediction, levels }
    }

    /// What the next one is guessed to be.
    pub fn prediction(&self) -> i64 {
        match self.prediction.order {
            0 => 0,
            1 => self.before(1).unwrap_or(0),
            _ => {
                let last = self.before(1).unwrap_or(0);
                let more = self.before(2).map_or(0, |first| last.wrapping_sub(first));
                last.wrapping_add(more)
            }
        }
    }

    /// What it was; an exception counts as the one before it.
    pub fn push(&mut self, level: Option<i64>) {
        let level = level.or_else(|| self.before(1)).unwrap_or(0);
        if self.levels.len() == self.prediction.distance.saturating_mul(2) {
            self.levels.pop_front();
        }
        self.levels.push_back(level);
    }

    fn before(&self, times: usize) -> Option<i64> {
        let back = self.prediction.distance.saturating_mul(times);
        let index = self.levels.len().checked_sub(back)?;
        self.levels.get(index).copied()
    }
}
