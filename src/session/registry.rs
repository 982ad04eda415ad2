//! Owns asking the routers: who is there, and by which connections (docs/registry.md has the keys); and changing those.
use std::time::Duration;

use serde::de::DeserializeOwned;
use zenoh::{bytes::ZBytes, query::Reply};

use super::robot::Robot;
use crate::{
    core::{
        connection::Connection,
        encoding::Encoding,
        name::Name,
        named_connection::{NamedConnection, ADD, CONFIG, REMOVE},
        payload::Payload,
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
        let answer = self.ask_router(robot, question, which, None).await?;
        Ok(answer.value()?)
    }

    /// Gives this robot's router a connection, instead of the one of that name if it has one; it is dialled from now on, and
    /// after a restart. One that it has already stays as it is.
    ///
    /// ```no_run
    /// # async fn added(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let base = rect::NamedConnection::new("base", "tcp", "192.168.125.2").port(7447);
    /// robot.add_connection(&base).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`]: the connection can't be, and why; [`Error::NoService`]: no router whose settings name a file of
    /// connections (`plugins/rect/connections`).
    pub async fn add_connection(&self, connection: &NamedConnection) -> Result<(), Error> {
        let robot = self.name().clone();
        self.add_connection_of(robot, connection).await
    }

    /// The same at another robot. Its access control has to allow that (`config/README.md`).
    ///
    /// # Errors
    /// As [`add_connection`](Self::add_connection), and [`Error::Name`].
    pub async fn add_connection_of<N: TryInto<Name>>(
        &self,
        robot: N,
        connection: &NamedConnection,
    ) -> Result<(), Error>
    where
        Error: From<N::Error>,
    {
        self.configure(robot.try_into()?, ADD, connection.to_json())
            .await
    }

    /// Takes a connection from this robot's router; its link ends.
    ///
    /// # Errors
    /// [`Error::Service`]: it has none of that name; [`Error::NoService`] as [`add_connection`](Self::add_connection).
    pub async fn remove_connection(&self, name: &str) -> Result<(), Error> {
        let robot = self.name().clone();
        self.remove_connection_of(robot, name).await
    }

    /// The same at another robot. Its access control has to allow that (`config/README.md`).
    ///
    /// # Errors
    /// As [`remove_connection`](Self::remove_connection), and [`Error::Name`].
    pub async fn remove_connection_of<N: TryInto<Name>>(
        &self,
        robot: N,
        name: &str,
    ) -> Result<(), Error>
    where
        Error: From<N::Error>,
    {
        self.configure(robot.try_into()?, REMOVE, name.to_owned())
            .await
    }

    async fn configure(&self, robot: Name, how: &str, what: String) -> Result<(), Error> {
        let parameters = format!("{how};by={}", self.name());
        self.ask_router(robot, CONFIG, &parameters, Some(what))
            .await?;
        Ok(())
    }

    async fn ask_router(
        &self,
        robot: Name,
        question: &str,
        parameters: &str,
        payload: Option<String>,
    ) -> Result<Payload, Error> {
        let key = self.inner.place.own(Some(&robot), question);
        let selector = match parameters {
            "" => key,
            _ => format!("{key}?{parameters}"),
        };
        let asked = self.inner.session.get(selector).timeout(PATIENCE);
        let asked = match payload {
            Some(payload) => asked.payload(payload).await,
            None => asked.await,
        };
        let replies = asked.map_err(Error::zenoh("the router can't be asked"))?;
        let json = |bytes: &ZBytes| Payload::new(bytes.to_bytes().into_owned(), Encoding::JSON);
        match replies.recv_async().await.map(Reply::into_result) {
            Ok(Ok(sample)) => Ok(json(sample.payload())),
            Ok(Err(error)) => {
                let (_, payload) = error_from_payload(json(error.payload()));
                let robot = Some(robot);
                Err(Error::Service { robot, payload })
            }
            Err(_) => Err(self.nobody(robot.to_string(), of_registry(question)).await),
        }
    }
}

/// The subject of a question, for the error when nobody answers.
fn of_registry(question: &str) -> String {
    if question == CONFIG {
        "changes of connections (the router's access control has to allow them, and its settings have to name a connections file)"
            .to_owned()
    } else {
        format!("the registry ({question})")
    }
}
