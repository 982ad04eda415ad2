//! Queries the routers for reachable robots and connections (docs/reference/registry.md lists the keys), and changes the
//! named connections of a router.
use std::time::Duration;

use serde::de::DeserializeOwned;
use zenoh::{bytes::ZBytes, query::Reply};

use super::{request::is_timeout, robot::Robot};
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

/// Timeout of a query. Routers reply at once, but a slow and busy link delays the reply.
const TIMEOUT: Duration = Duration::from_secs(5);

impl Robot {
    /// Returns the names of the other robots of the fleet that are reachable now, in alphabetical order.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if the session is closed.
    pub async fn peers(&self) -> Result<Vec<Name>, Error> {
        let place = &self.inner.place;
        let asked = self
            .inner
            .session
            .liveliness()
            .get(place.own(None, "alive/*"));
        let asked = asked.timeout(TIMEOUT).await;
        let replies = asked.map_err(Error::zenoh("cannot query the reachable robots"))?;
        let mut peers = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            let robot = place.robot_of(sample.key_expr().as_str());
            peers.extend(robot.filter(|robot| *robot != place.robot));
        }
        peers.sort();
        peers.dedup();
        Ok(peers)
    }

    /// Returns the connections of this robot's router: named connections, links, and discovered robots.
    ///
    /// # Errors
    /// [`Error::NoService`] if the robot has no router with RECT's registry, [`Error::Service`] if the router rejects the
    /// query, [`Error::TimedOut`] if no reply arrives within 5 s, and [`Error::Zenoh`] if the session is closed.
    pub async fn connections(&self) -> Result<Vec<Connection>, Error> {
        self.connections_of(self.name().clone(), "").await
    }

    /// Returns the connections of the router of `robot` that match `filter`, such as `method=ble` or
    /// `peer=wombat-2;state=connected` (docs/reference/registry.md). An empty filter matches all.
    ///
    /// # Errors
    /// Returns the errors of [`connections`](Self::connections), and [`Error::Name`] if `robot` is not a valid name.
    pub async fn connections_of<N: TryInto<Name>>(
        &self,
        robot: N,
        filter: &str,
    ) -> Result<Vec<Connection>, Error>
    where
        Error: From<N::Error>,
    {
        self.query_registry(robot.try_into()?, "connections", filter)
            .await
    }

    /// Sends any query to the registry of `robot`, such as `connections/count` or `status` (docs/reference/registry.md), and
    /// deserializes the JSON reply as `T`.
    ///
    /// # Errors
    /// Returns the errors of [`connections`](Self::connections), and [`Error::Payload`] if the reply cannot be
    /// deserialized as `T`.
    pub async fn query_registry<T: DeserializeOwned>(
        &self,
        robot: Name,
        question: &str,
        filter: &str,
    ) -> Result<T, Error> {
        let reply = self.query_router(robot, question, filter, None).await?;
        Ok(reply.value()?)
    }

    /// Adds a named connection to this robot's router, replacing the one of the same name. The router dials it from now on,
    /// also after a restart. If an identical connection exists, it stays connected.
    ///
    /// ```no_run
    /// # async fn add(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let base = rect::NamedConnection::new("base", "tcp", "192.168.125.2").port(7447);
    /// robot.add_connection(&base).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`] with the reason if the router rejects the connection; [`Error::NoService`] if the robot has no
    /// router whose configuration names a connections file (`plugins/rect/connections`); [`Error::TimedOut`] if no reply
    /// arrives within 5 s.
    pub async fn add_connection(&self, connection: &NamedConnection) -> Result<(), Error> {
        let robot = self.name().clone();
        self.add_connection_of(robot, connection).await
    }

    /// Adds a named connection to the router of another robot, whose access control must permit it
    /// (`docs/reference/configuration.md`).
    ///
    /// # Errors
    /// Returns the errors of [`add_connection`](Self::add_connection), and [`Error::Name`] if `robot` is not a valid name.
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

    /// Removes a named connection from this robot's router and closes its link.
    ///
    /// # Errors
    /// [`Error::Service`] if the router has no connection of that name; [`Error::NoService`] and [`Error::TimedOut`] as
    /// for [`add_connection`](Self::add_connection).
    pub async fn remove_connection(&self, name: &str) -> Result<(), Error> {
        let robot = self.name().clone();
        self.remove_connection_of(robot, name).await
    }

    /// Removes a named connection from the router of another robot, whose access control must permit it
    /// (`docs/reference/configuration.md`).
    ///
    /// # Errors
    /// Returns the errors of [`remove_connection`](Self::remove_connection), and [`Error::Name`] if `robot` is not a valid
    /// name.
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

    async fn configure(&self, robot: Name, action: &str, payload: String) -> Result<(), Error> {
        let parameters = format!("{action};by={}", self.name());
        self.query_router(robot, CONFIG, &parameters, Some(payload))
            .await?;
        Ok(())
    }

    async fn query_router(
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
        let asked = self.inner.session.get(selector).timeout(TIMEOUT);
        let asked = match payload {
            Some(payload) => asked.payload(payload).await,
            None => asked.await,
        };
        let replies = asked.map_err(Error::zenoh("cannot query the router"))?;
        let json = |bytes: &ZBytes| Payload::new(bytes.to_bytes().into_owned(), Encoding::JSON);
        match replies.recv_async().await.map(Reply::into_result) {
            Ok(Ok(sample)) => Ok(json(sample.payload())),
            Ok(Err(error)) => {
                let (replied, payload) = error_from_payload(json(error.payload()));
                if is_timeout(replied.as_ref(), &payload) {
                    return Err(Error::TimedOut {
                        expected: format!("reply from the router of {robot} about {question}"),
                        timeout: TIMEOUT,
                    });
                }
                let robot = Some(robot);
                Err(Error::Service { robot, payload })
            }
            Err(_) => Err(self
                .no_service(robot.to_string(), of_registry(question))
                .await),
        }
    }
}

/// Returns the name of the queried service for the error that is returned if no router replies.
fn of_registry(question: &str) -> String {
    if question == CONFIG {
        "changes of connections (the router's access control must allow them, and its settings must name a connections file)"
            .to_owned()
    } else {
        format!("the registry ({question})")
    }
}
