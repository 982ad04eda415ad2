//! The services of the fleet: those of the robots' catalogues are listed, and viewers may use the permitted ones.
use std::collections::BTreeMap;

use foxglove::{
    websocket::{
        service::{Request, Service, ServiceSchema},
        ConnectionGraph,
    },
    FoxgloveError, Schema, WebSocketServerHandle,
};
use rect::{Error, Name, Pattern, Payload, Robot, RobotTopic};
use rect_dashboard::programs;
use rect_recording::view;

use crate::Failure;

/// The largest number of services that are listed for viewers.
const MAX_SERVICES: usize = 1024;

/// The services of the fleet.
pub struct Services {
    robot: Robot,
    permitted: Vec<Pattern>,
    /// The listed services by their names, each with the programs that serve it.
    listed: BTreeMap<String, Vec<String>>,
    /// The services that viewers may use.
    offered: BTreeMap<String, RobotTopic>,
}

/// The programs' services of the robots, each with the name of its program.
pub type Found = Vec<(RobotTopic, String)>;

impl Services {
    /// Creates the list. Viewers may use the services that match a pattern; one without a wildcard is offered at once, even if no
    /// catalogue has it.
    pub fn new(robot: Robot, permitted: Vec<Pattern>) -> Self {
        let exact = permitted.iter().filter_map(|pattern| {
            let robot = pattern.robot()?.clone();
            let topic = pattern.topic().parse().ok()?;
            Some(RobotTopic { robot, topic })
        });
        let offered = exact.map(|service| (name(&service), service)).collect();
        Self {
            robot,
            permitted,
            listed: BTreeMap::new(),
            offered,
        }
    }

    /// Returns the services that a server for viewers offers from its start.
    pub fn offered(&self) -> Vec<Service> {
        let offered = self.offered.values().cloned();
        offered.map(|service| self.offer(service)).collect()
    }

    /// Lists what the robots' programs serve, and offers what is new and permitted. A service whose program has ended stays offered: a
    /// request says that nobody serves it.
    ///
    /// # Errors
    /// Fails if the server does not take a service.
    pub fn on_found(
        &mut self,
        found: Found,
        server: &WebSocketServerHandle,
    ) -> Result<(), FoxgloveError> {
        self.listed.clear();
        let mut new = Vec::new();
        for (service, program) in found.into_iter().take(MAX_SERVICES) {
            let (name, topic) = (name(&service), service.to_string());
            let is_permitted = self.permitted.iter().any(|pattern| pattern.matches(&topic));
            let is_new = self.offered.len() < MAX_SERVICES && !self.offered.contains_key(&name);
            if is_permitted && is_new {
                self.offered.insert(name.clone(), service.clone());
                new.push(self.offer(service));
            }
            self.listed.entry(name).or_default().push(program);
        }
        match new.is_empty() {
            true => Ok(()),
            false => server.add_services(new),
        }
    }

    /// Adds to the graph which program serves what.
    pub fn add_to(&self, graph: &mut ConnectionGraph) {
        for (name, programs) in &self.listed {
            graph.set_advertised_service(name, programs);
        }
    }

    /// Returns a service for viewers that sends requests to a service of a robot.
    fn offer(&self, service: RobotTopic) -> Service {
        let name = name(&service);
        let object = || Schema::new("object", "jsonschema", br#"{"type":"object"}"#.as_slice());
        let schema = ServiceSchema::new(&name)
            .with_request("json", object())
            .with_response("json", object());
        let robot = self.robot.clone();
        Service::builder(name, schema).async_handler_fn(move |request| {
            let (robot, service) = (robot.clone(), service.clone());
            async move { answer(&robot, &service, &request).await }
        })
    }
}

/// Returns the name of a service for viewers.
fn name(service: &RobotTopic) -> String {
    format!("/{service}")
}

/// Asks the routers of these robots what their programs serve. A robot without a catalogue is left out.
///
/// # Errors
/// Fails if the session is closed.
pub async fn find(robot: &Robot, robots: impl IntoIterator<Item = Name>) -> Result<Found, Error> {
    let mut found = Vec::new();
    for (name, answer) in programs::query(robot, robots).await {
        let programs = match answer {
            Ok(programs) => programs,
            Err(Error::Closed) => return Err(Error::Closed),
            Err(_) => continue,
        };
        for program in programs {
            let title = format!("{name}/{}", program.title());
            let services = program.requestable().map(|service| {
                let (robot, topic) = (name.clone(), service.topic.clone());
                (RobotTopic { robot, topic }, title.clone())
            });
            found.extend(services);
        }
    }
    Ok(found)
}

async fn answer(
    robot: &Robot,
    service: &RobotTopic,
    request: &Request,
) -> Result<Vec<u8>, Failure> {
    let payload = view::payload(request.payload())?;
    let (asked, topic) = (service.robot.clone(), &service.topic);
    let asked = robot.request::<Payload>(asked, topic, payload);
    let reply = asked.await?;
    Ok(view::object(&reply.payload).to_string().into_bytes())
}
