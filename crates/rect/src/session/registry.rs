//! Queries the routers for reachable robots and connections (docs/reference/registry.md lists the keys), and changes the
//! named connections of a router.
use std::{convert::Infallible, time::Instant};

use rect_core::{
    catalogue::{self, Program, ServiceEntry, PAUSE},
    cause::Cause,
    driver::Driver,
    message::payload::{Payload, PayloadError},
    name::Name,
    registry::{
        connection::Connection,
        named_connection::{NamedConnection, ADD, REMOVE},
        RegistryError, RegistryQuery,
    },
    session::peers::{PeersQuery, TIMEOUT},
};
use serde::de::DeserializeOwned;

use super::{executor::Executor, robot::Robot, shared::NoItems};
use crate::error::{valid, Error};

impl Robot {
    /// Returns the names of the other robots of the fleet that are reachable now, in alphabetical order.
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn peers(&self) -> Result<Vec<Name>, Error> {
        let query = PeersQuery::new(self.inner.place.clone());
        Executor::new(&self.inner.session, query, NoItems)
            .run()
            .await
    }

    /// Returns the connections of this robot's router: named connections, links, and discovered robots.
    ///
    /// # Errors
    /// [`Error::NoService`] if the robot has no router with RECT's registry, [`Error::Service`] if the router rejects the
    /// query, [`Error::TimedOut`] if no reply arrives within 5 s, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn connections(&self) -> Result<Vec<Connection>, Error> {
        self.connections_of(self.name().clone(), "").await
    }

    /// Returns the connections of the router of `robot` that match `filter`, such as `method=ble` or
    /// `peer=wombat-2;state=connected` (docs/reference/registry.md). An empty filter matches all.
    ///
    /// # Errors
    /// Returns the errors of [`connections`](Self::connections), and [`Error::Name`] if `robot` is not a valid name.
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn connections_of(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        filter: &str,
    ) -> Result<Vec<Connection>, Error> {
        self.query_registry(valid(robot)?, "connections", filter)
            .await
    }

    /// Sends any query to the registry of `robot`, such as `connections/count` or `status` (docs/reference/registry.md), and
    /// deserializes the JSON reply as `T`.
    ///
    /// # Errors
    /// Returns the errors of [`connections`](Self::connections), and [`Error::Payload`] if the reply cannot be
    /// deserialized as `T`.
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn query_registry<T: DeserializeOwned>(
        &self,
        robot: Name,
        question: &str,
        filter: &str,
    ) -> Result<T, Error> {
        let place = self.inner.place.clone();
        let query = RegistryQuery::new(place, robot.clone(), question, filter);
        Ok(self.query_router(robot, query).await?.value()?)
    }

    /// Returns the programs of `robot` that have a name or serve something, each with its services, in the order in which they began.
    /// An answer is kept until the robot's programs announce a change (at most once a second), so that asking again costs nothing on
    /// the air.
    ///
    /// ```no_run
    /// # async fn look(robot: rect::Robot) -> Result<(), rect::Error> {
    /// for program in robot.programs("wombat-2").await? {
    ///     for service in &program.services {
    ///         println!("{} serves {}: {}", program.title(), service.topic, service.about);
    ///     }
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the errors of [`connections`](Self::connections), [`Error::Name`] if `robot` is not a valid name, and
    /// [`Error::Payload`] if the reply is not a catalogue.
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn programs(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
    ) -> Result<Vec<Program>, Error> {
        let (inner, robot) = (&self.inner, valid(robot)?);
        let query = inner.catalogues.query(inner.place.clone(), robot.clone());
        let answer = self.query_router(robot, query).await?;
        let read = catalogue::read(&answer.bytes).map_err(|error| PayloadError::Read {
            format: "JSON of a catalogue",
            reason: Cause::new(error),
        });
        Ok(read?)
    }

    /// Handles that `robot` does not serve something of that name: something that was just declared may be in the catalogue before it can
    /// be reached, so that this pauses until the next attempt. Returns the names in the catalogue if there is no reason for one: it does
    /// not contain the name, or the time has passed.
    pub(super) async fn unless_declared(
        &self,
        robot: &Name,
        name: &str,
        until: Instant,
        names: impl Fn(&Program) -> Vec<String>,
    ) -> Option<Vec<String>> {
        let programs = self.programs(robot).await.unwrap_or_default();
        let listed: Vec<_> = programs.iter().flat_map(names).collect();
        if Instant::now() >= until || !listed.iter().any(|known| known == name) {
            return Some(listed);
        }
        tokio::time::sleep(PAUSE).await;
        None
    }

    /// Returns what the programs of `robot` serve, in alphabetical order of the topics. [`programs`](Self::programs) also states which
    /// program serves what.
    ///
    /// ```no_run
    /// # async fn list(robot: rect::Robot) -> Result<(), rect::Error> {
    /// for service in robot.services("wombat-2").await? {
    ///     println!("{}: {}", service.topic, service.about);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the errors of [`programs`](Self::programs).
    ///
    /// # Cancel safety
    /// Dropping the future abandons the question. Nothing else changes.
    pub async fn services(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
    ) -> Result<Vec<ServiceEntry>, Error> {
        let programs = self.programs(robot).await?;
        let services = programs.iter().flat_map(Program::requestable).cloned();
        let mut services: Vec<_> = services.collect();
        services.sort_by(|one, other| one.topic.as_str().cmp(other.topic.as_str()));
        Ok(services)
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
    ///
    /// # Cancel safety
    /// If the future is dropped, the router may have made the change, or may still make it.
    pub async fn add_connection(&self, connection: &NamedConnection) -> Result<(), Error> {
        let robot = self.name().clone();
        self.add_connection_of(robot, connection).await
    }

    /// Adds a named connection to the router of another robot, whose access control must permit it
    /// (`docs/reference/configuration.md`).
    ///
    /// # Errors
    /// Returns the errors of [`add_connection`](Self::add_connection), and [`Error::Name`] if `robot` is not a valid name.
    ///
    /// # Cancel safety
    /// If the future is dropped, the router may have made the change, or may still make it.
    pub async fn add_connection_of(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        connection: &NamedConnection,
    ) -> Result<(), Error> {
        self.configure(valid(robot)?, ADD, connection.to_json())
            .await
    }

    /// Removes a named connection from this robot's router and closes its link.
    ///
    /// # Errors
    /// [`Error::Service`] if the router has no connection of that name; [`Error::NoService`] and [`Error::TimedOut`] as
    /// for [`add_connection`](Self::add_connection).
    ///
    /// # Cancel safety
    /// If the future is dropped, the router may have made the change, or may still make it.
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
    ///
    /// # Cancel safety
    /// If the future is dropped, the router may have made the change, or may still make it.
    pub async fn remove_connection_of(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        name: &str,
    ) -> Result<(), Error> {
        self.configure(valid(robot)?, REMOVE, name.to_owned()).await
    }

    async fn configure(&self, robot: Name, action: &str, argument: String) -> Result<(), Error> {
        let place = self.inner.place.clone();
        let change = RegistryQuery::change(place, robot.clone(), action, argument);
        self.query_router(robot, change).await?;
        Ok(())
    }

    async fn query_router<D>(&self, robot: Name, query: D) -> Result<Payload, Error>
    where
        D: Driver<Item = Infallible, Output = Result<Payload, RegistryError>> + Send + 'static,
    {
        let executor = Executor::new(&self.inner.session, query, NoItems);
        executor.run().await?.map_err(|error| match error {
            RegistryError::Rejected(payload) => Error::Service {
                robot: Some(robot),
                payload,
            },
            RegistryError::TimedOut { expected } => Error::TimedOut {
                expected,
                timeout: TIMEOUT,
            },
            RegistryError::NoService { service, available } => Error::NoService {
                robot: Some(robot),
                topic: service,
                available,
            },
            RegistryError::Closed => Error::Closed,
        })
    }
}
