//! Changes the parameters of programs.
use std::collections::BTreeMap;

use rect_core::{
    message::payload::Payload,
    name::{topic::Topic, Name},
    parameters::{
        self,
        order::{to_cbor, InForce, Order, Reset, Stored},
        Value,
    },
};

use crate::{
    error::{valid, Error},
    session::{request::Replies, robot::Robot},
};

/// What to change in a group of parameters, all or nothing. An array of names and values is one: `[("kp", 2.0)]`.
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
        if let Some(program) = &self.inner.program.driver().program().name {
            order.by = program.to_string();
        }
        let is_stored = order.stored;
        let payload = to_cbor(&order);
        let asked = match is_stored {
            false => {
                let reply = self.request::<Payload>(robot.clone(), topic, payload).await;
                reply.map(|reply| reply.payload)
            }
            true => {
                self.request_until_stored(robot.clone(), topic, payload)
                    .await
            }
        };
        match asked {
            Ok(reply) => Ok(reply.value::<InForce>()?.values),
            Err(Error::NoService { .. }) => Err(self.no_parameters(robot, group).await),
            Err(error) => Err(error),
        }
    }

    async fn request_until_stored(
        &self,
        robot: Name,
        topic: Topic,
        payload: Payload,
    ) -> Result<Payload, Error> {
        let replies: Replies = self
            .request_stream(robot.clone(), topic.clone(), payload)
            .await?;
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
                robot,
                reason: stored.reason,
            }),
        }
    }

    /// Returns the error that a robot has no such group, with those that it has.
    async fn no_parameters(&self, robot: Name, group: &str) -> Error {
        let programs = self.programs(&robot).await.unwrap_or_default();
        let groups = programs.iter().flat_map(|program| program.parameters());
        Error::NoParameters {
            group: group.to_owned(),
            available: groups.map(|(group, _)| group.to_owned()).collect(),
            robot,
        }
    }
}
