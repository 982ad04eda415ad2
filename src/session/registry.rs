//! Owns asking the routers' registry: who is there, and by which connections (docs/registry.md has the keys).
use std::time::Duration;

use serde::de::DeserializeOwned;
use zenoh::bytes::ZBytes;

use super::robot::Robot;
use crate::{
    core::{
        connection::Connection, encoding::Encoding, name::Name, payload::Payload,
        request::error_from_payload,
    },
    error::Error,
};

/// Routers answer at once; a slow link with much on it takes a while.
const PATIENCE: Duration = Duration::from_secs(5);

impl Robot {
    /// The other robots of the fleet that are there now, by name.
    ///
    /// # Errors
    /// [`Error::Zenoh`] when the session is closed.
    pub async fn peers(&self) -> Result<Vec<Name>, Error> {
        let place = &self.inner.place;
        let asked = self
            .inner
            .session
            .liveliness()
            .get(place.own(None, "alive/*"));
        let asked = asked.timeout(PATIENCE).await;
        let replies = asked.map_err(Error::zenoh("who is there is not known"))?;
        let mut there = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            let robot = place.robot_of(sample.key_expr().as_str());
            there.extend(robot.filter(|robot| *robot != place.robot));
        }
        there.sort();
        there.dedup();
        Ok(there)
    }

    /// The connections of this robot's router.
    ///
    /// # Errors
    /// [`Error::NoService`]: no router with RECT's registry; [`Error::Service`].
    pub async fn connections(&self) -> Result<Vec<Connection>, Error> {
        self.connections_of(self.name().clone(), "").await
    }

    /// The connections of a robot, those that `which` selects: `method=ble`, `peer=wombat-2;state=connected`
    /// (docs/registry.md).
    ///
    /// # Errors
    /// As [`connections`](Self::connections), and [`Error::Name`].
    pub async fn connections_of<N: TryInto<Name>>(
        &self,
        robot: N,
        which: &str,
    ) -> Result<Vec<Connection>, Error>
    where
        Error: From<N::Error>,
    {
        self.ask_registry(robot.try_into()?, "connections", which)
            .await
    }

    /// Any other question of the registry, as `connections/count` or `status` (docs/registry.md).
    ///
    /// # Errors
    /// As [`connections_of`](Self::connections_of); [`Error::Payload`] if the answer is not of that shape.
    pub async fn ask_registry<T: DeserializeOwned>(
        &self,
        robot: Name,
        question: &str,
        which: &str,
    ) -> Result<T, Error> {
        let key = self.inner.place.own(Some(&robot), question);
        let selector = if which.is_empty() {
            key.clone()
        } else {
            format!("{key}?{which}")
        };
        let asked = self.inner.session.get(selector).timeout(PATIENCE).await;
        let replies = asked.map_err(Error::zenoh("the registry can't be asked"))?;
        let json = |bytes: &ZBytes| Payload::new(bytes.to_bytes().into_owned(), Encoding::JSON);
        match replies
            .recv_async()
            .await
            .map(zenoh::query::Reply::into_result)
        {
            Ok(Ok(sample)) => Ok(json(sample.payload()).value()?),
            Ok(Err(error)) => {
                let (_, payload) = error_from_payload(json(error.payload()));
                let robot = Some(robot);
                Err(Error::Service { robot, payload })
            }
            Err(_) => Err(self
                .nobody(robot.to_string(), format!("the registry ({question})"))
                .await),
        }
    }
}
