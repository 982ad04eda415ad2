//! Converts numbers to levels (whole numbers of steps) and back, and predicts levels from the previous ones.
use std::collections::VecDeque;

use super::varint;
use crate::codec::array::Number;

/// The largest level; larger numbers are exceptions. Up to here, every whole number is an `f64`, and differences of
/// differences fit 64 bits.
const MAX_LEVEL: f64 = (1u64 << 51) as f64;

/// The floating-point types.
pub trait Float: Number {
    /// Half of the gap between two adjacent values near 1: the largest relative rounding error of the type.
    const HALF_GAP: f64;
    /// Converts without loss.
    fn wide(self) -> f64;
    /// Converts to the nearest value.
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

/// Returns the step for which hardly any number is off by more than `error`: twice the error, reduced by the rounding
/// error of the type.
pub fn step<T: Float>(numbers: &[T], error: f64) -> f32 {
    let sizes = numbers.iter().map(|number| number.wide().abs());
    let largest = sizes.filter(|size| size.is_finite()).fold(0.0, f64::max);
    let rounding = largest * T::HALF_GAP;
    let left = if rounding < error / 2.0 {
        error - rounding
    } else {
        error
    };
    let exact = left * (2.0 - 1e-9);
    let step = exact as f32;
    if f64::from(step) > exact {
        // The next smaller value. The step is positive and far from 0.
        return f32::from_bits(step.to_bits() - 1);
    }
    step
}

/// Returns the number that a level stands for.
pub fn number<T: Float>(level: i64, step: f32) -> T {
    T::narrow(level as f64 * f64::from(step))
}

/// Returns the level of a number. `None` if no level is closer to it than `error`.
pub fn level<T: Float>(value: T, step: f32, error: f64) -> Option<i64> {
    let steps = (value.wide() / f64::from(step)).round();
    if steps.is_nan() || steps.abs() > MAX_LEVEL {
        return None;
    }
    let level = steps as i64;
    let off = (number::<T>(level, step).wide() - value.wide()).abs();
    (off <= error).then_some(level)
}

/// How a level is predicted from the previous ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prediction {
    /// 0 predicts 0, 1 the previous level, 2 a constant slope.
    pub order: u8,
    /// How far back the previous level is: 1, or the length of a row if rows or channels resemble each other.
    pub distance: usize,
}

impl Prediction {
    /// Returns the prediction with the smallest residuals.
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

/// The previous levels, from which the next one is predicted.
pub struct Past {
    prediction: Prediction,
    levels: VecDeque<i64>,
}

impl Past {
    /// Creates an empty history.
    pub fn new(prediction: Prediction) -> Self {
        let levels = VecDeque::new();
        Self { prediction, levels }
    }

    /// Returns the prediction of the next level.
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

    /// Adds a level. An exception (`None`) repeats the level at the prediction's distance.
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
