//! Changes the parameters of programs.
use std::{collections::BTreeMap, time::Instant};

use rect_core::{
    catalogue::{Program, DECLARED_WITHIN, PAUSE},
    message::payload::Payload,
    name::{topic::Topic, Name},
    parameters::{
        self,
        order::{to_cbor, InForce, Order, Reset, Stored},
        Value,
    },
};

use tokio::time::sleep;

use crate::{
    error::{valid, Error},
    session::{request::Replies, robot::Robot},
};

/// A change of parameters of a group, all or nothing. An array of names and values is one: `[("kp", 2.0)]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParameterOrder(pub(super) Order);

impl ParameterOrder {
    /// Sets values.
    pub fn set<K: Into<String>, V: Into<Value>>(values: impl IntoIterator<Item = (K, V)>) -> Self {
        Self(Order::set(values))
    }

    /// Gives these parameters their defaults.
    pub fn reset<K: Into<String>>(names: impl IntoIterator<Item = K>) -> Self {
        Self(Order {
            reset: Reset::Some(names.into_iter().map(Into::into).collect()),
            ..Order::default()
        })
    }

    /// Gives all parameters their defaults, except for those that are read-only.
    pub fn reset_all() -> Self {
        Self(Order {
            reset: Reset::All(true),
            ..Order::default()
        })
    }

    /// Waits until the values are stored. Default: until they are in force, which is up to a second earlier.
    #[must_use]
    pub fn stored(self) -> Self {
        Self(Order {
            stored: true,
            ..self.0
        })
    }
}

impl<K: Into<String>, V: Into<Value>, const N: usize> From<[(K, V); N]> for ParameterOrder {
    fn from(values: [(K, V); N]) -> Self {
        Self::set(values)
    }
}

impl From<BTreeMap<String, Value>> for ParameterOrder {
    fn from(values: BTreeMap<String, Value>) -> Self {
        Self::set(values)
    }
}

impl Robot {
    /// Changes parameters of a program of `robot`: all or none. Returns those that the order names, with the values that are in force
    /// now. Access control may permit it to some only (`@rect/@set/parameters/**`).
    ///
    /// An order that ends without a reply in the first second, for example because the program has just begun, is sent again. That is
    /// safe unless somebody else changes the same values in between: an order that is carried out twice leaves the same ones.
    ///
    /// ```no_run
    /// # async fn tune(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.set_parameters("wombat-2", "drive", [("kp", 2.0)]).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`] with the reason if the program refuses a value, [`Error::NoParameters`] if it has no such group,
    /// [`Error::NotStored`] if it cannot store the values, for which [`stored`](ParameterOrder::stored) waits: they are in force. The
    /// other errors are those of [`request`](Self::request).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the parameters may be changed or not.
    pub async fn set_parameters(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        group: &str,
        order: impl Into<ParameterOrder>,
    ) -> Result<BTreeMap<String, Value>, Error> {
        let robot: Name = valid(robot)?;
        let topic = Topic::of_parameters(group).ok_or_else(|| Error::Parameters {
            reason: parameters::wrong_group(group),
        })?;
        let ParameterOrder(mut order) = order.into();
        order.by = self.program_name();
        let payload = to_cbor(&order);
        let until = Instant::now() + DECLARED_WITHIN;
        loop {
            match self.order(&robot, &topic, &payload, order.stored).await {
                Ok(reply) => return Ok(reply.value::<InForce>()?.values),
                Err(Error::NoService { .. }) => {
                    let groups = |program: &Program| {
                        program
                            .parameters()
                            .map(|(name, _)| name.to_owned())
                            .collect()
                    };
                    if let Some(available) =
                        self.unless_declared(&robot, group, until, groups).await
                    {
                        let group = group.to_owned();
                        return Err(Error::NoParameters {
                            robot,
                            group,
                            available,
                        });
                    }
                }
                // A group that was declared while the order was in flight, or whose program was started again.
                Err(Error::Interrupted { .. }) if Instant::now() < until => sleep(PAUSE).await,
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends an order once. Returns the reply with the values that are in force, if `stored` after they are stored.
    async fn order(
        &self,
        robot: &Name,
        topic: &Topic,
        order: &Payload,
        stored: bool,
    ) -> Result<Payload, Error> {
        if !stored {
            let asked = self.request::<Payload>(robot, topic.clone(), order);
            return Ok(asked.await?.payload);
        }
        let replies: Replies = self.request_stream(robot, topic.clone(), order).await?;
        let ended = || Error::Interrupted {
            robot: Some(robot.clone()),
            topic: topic.to_string(),
        };
        let in_force = replies.next().await.ok_or_else(ended)??;
        let stored = replies.next().await.ok_or_else(ended)??;
        let stored: Stored = stored.payload.value()?;
        match stored.stored {
            true => Ok(in_force.payload),
            false => Err(Error::NotStored {
                robot: robot.clone(),
                reason: stored.reason,
            }),
        }
    }
}
