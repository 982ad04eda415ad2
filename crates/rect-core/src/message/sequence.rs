//! Decides from the sequence numbers of one source which of its messages are missing.
//!
//! A single number that is far ahead, whatever has sent it, must not make all later messages of the source seem late. Therefore
//! several late messages in a row, in order among themselves, take over the numbering.

/// The number of such messages. A burst that a single message has overtaken may have as many; the count of the missing ones is then
/// wrong by that one.
const TAKE_OVER: u32 = 8;

/// The place of a message among those of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The message follows the last one, except for those that have not arrived.
    Next {
        /// The number of messages between them.
        missed: u32,
    },
    /// The message has the number of the last one.
    Repeated,
    /// A message that was sent later has arrived before. This one had been counted as missed.
    Late,
    /// The message seemed to be late, as several before it. The numbering continues from it.
    Renumbered {
        /// The number of messages that were counted as missed because of the last number.
        miscounted: u32,
    },
}

/// The numbers of one source, modulo 2^32.
#[derive(Debug)]
pub struct Sequence {
    last: u32,
    /// The number of messages that were missing before the last one.
    missed: u32,
    /// The late messages since then: the number of the latest, and how many were in order.
    late: (u32, u32),
}

impl Sequence {
    /// Begins with a message of that number. Those before it are not missed.
    pub fn new(number: u32) -> Self {
        Self {
            last: number,
            missed: 0,
            late: (0, 0),
        }
    }

    /// Handles the next message.
    pub fn on_message(&mut self, number: u32) -> Order {
        match number.wrapping_sub(self.last) {
            0 => Order::Repeated,
            ahead if is_ahead(ahead) => {
                let missed = ahead - 1;
                *self = Self {
                    missed,
                    ..Self::new(number)
                };
                Order::Next { missed }
            }
            _ => self.on_late(number),
        }
    }

    fn on_late(&mut self, number: u32) -> Order {
        let (latest, count) = self.late;
        let is_in_order = count > 0 && is_ahead(number.wrapping_sub(latest));
        let count = if is_in_order { count + 1 } else { 1 };
        if count < TAKE_OVER {
            self.late = (number, count);
            return Order::Late;
        }
        let miscounted = self.missed;
        *self = Self::new(number);
        Order::Renumbered { miscounted }
    }
}

fn is_ahead(difference: u32) -> bool {
    (1..=u32::MAX / 2).contains(&difference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_missed_until_their_messages_arrive() {
        let mut sequence = Sequence::new(7);
        let orders = [8, 11, 10, 9, 11, 12].map(|number| sequence.on_message(number));
        let next = |missed| Order::Next { missed };
        let expected = [
            next(0),
            next(2),
            Order::Late,
            Order::Late,
            Order::Repeated,
            next(0),
        ];
        assert_eq!(orders, expected);
    }

    #[test]
    fn numbers_wrap_around() {
        let mut sequence = Sequence::new(u32::MAX - 1);
        assert_eq!(sequence.on_message(1), Order::Next { missed: 2 });
        assert_eq!(sequence.on_message(u32::MAX), Order::Late);
    }

    #[test]
    fn one_number_far_ahead_does_not_make_all_later_messages_late() {
        for ahead in [2, 1000, 1 << 30] {
            let mut sequence = Sequence::new(100);
            let missed = ahead - 1;
            let forged = sequence.on_message(100 + ahead);
            assert_eq!(forged, Order::Next { missed });
            let orders: Vec<_> = (101..150).map(|n| sequence.on_message(n)).collect();
            let late = orders.iter().filter(|order| **order == Order::Late);
            assert!(late.count() < 8, "{ahead}: {orders:?}");
            assert_eq!(orders.last(), Some(&Order::Next { missed: 0 }));
            if ahead > 8 {
                let miscounted = missed;
                assert!(orders.contains(&Order::Renumbered { miscounted }));
            }
        }
    }

    #[test]
    fn two_sources_that_chose_the_same_number_do_not_take_over_from_each_other() {
        let mut sequence = Sequence::new(5000);
        for n in 0..100 {
            assert_eq!(sequence.on_message(10 + n), Order::Late);
            assert_eq!(sequence.on_message(5001 + n), Order::Next { missed: 0 });
        }
    }
}
