//! Implements `rect foxglove`: shows messages in viewers, by the Foxglove WebSocket protocol.
mod frames;
mod gate;
mod input;
mod listener;
mod live;
mod logs;
mod parameters;
mod services;

use std::{
    net::SocketAddr,
    process::ExitCode,
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use foxglove::{
    websocket::{service::Service, Capability, Parameter},
    Context, FoxgloveError, WebSocketServer, WebSocketServerHandle,
};
use rect::{Message, Name, Pattern, Robot, Subscriber};
use rect_core::{
    parameters::order::Snapshot,
    registry::topics::{Topics, KEPT},
};
use rect_dashboard::topics::query;
use tokio::{
    sync::{mpsc, watch},
    task::JoinSet,
    time::interval,
};

use self::{
    gate::{Gate, Inside, Rules},
    input::Input,
    listener::Listener,
    live::Live,
    logs::Logs,
    parameters::{Parameters, Shown},
    services::{Found, Services},
};
use crate::{session::JoinArguments, Done, Failure};

/// Number of messages that wait for one viewer at most. Beyond that, the oldest is dropped.
const BACKLOG: usize = 64;
/// How often the routers are asked for topics while a viewer is connected.
const ASKED_EVERY: Duration = Duration::from_secs(4);
/// How long a router counts messages before it is asked again for the first time.
const COUNTED: Duration = Duration::from_secs(1);
/// How often it is checked which topics are shown, in addition to the viewers' requests.
const UPDATED_EVERY: Duration = Duration::from_secs(1);
/// Number of events of viewers that wait at most.
const EVENTS: usize = 256;

/// Show live messages in Foxglove, Lichtblick or another viewer, until Ctrl-C
///
/// In the viewer, open the connection `Foxglove WebSocket` to the address that is printed. A topic is transmitted only
/// while a viewer shows it.
#[derive(Args)]
pub struct FoxgloveArguments {
    /// The topics to offer, <robot>/<topic> with wildcards [default: all of the fleet]
    patterns: Vec<Pattern>,
    /// The address and port for viewers. Any computer that reaches it sees the messages
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
    /// Accept viewers that use this host name, besides those of this computer; can be repeated
    #[arg(long = "name", value_name = "HOST")]
    names: Vec<String>,
    /// Accept viewers that are pages of this site, such as https://example.org, besides app.foxglove.dev and pages that this
    /// computer serves; can be repeated
    #[arg(long = "site", value_name = "ORIGIN")]
    sites: Vec<String>,
    /// Let viewers publish as this robot, send messages to others on /to/<robot>/<topic>, and change the parameters of programs
    #[arg(long)]
    publish: bool,
    /// Let viewers send requests to the services that match, such as wombat-2/battery or '*/**'; can be repeated
    #[arg(long = "service", value_name = "ROBOT/TOPIC")]
    services: Vec<Pattern>,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect foxglove`.
pub async fn run(arguments: FoxgloveArguments) -> Done {
    // Without a robot there is nobody to publish as.
    let robot = match arguments.publish {
        true => arguments.join.join().await?,
        false => arguments.join.join_unnamed().await?,
    };
    let (send, mut events) = mpsc::channel(EVENTS);
    let address = arguments.listen;
    let rules = Rules::new(&arguments.names, arguments.sites);
    let gate = Gate::bind(address, rules).await.map_err(|error| {
        format!("cannot listen on {address}: {error}; choose another one with --listen")
    })?;
    let at = gate.address()?;
    let input = arguments.publish.then(|| Input::start(&robot));
    let viewers = Viewers {
        robot: robot.clone(),
        context: Context::new(),
        shown: Shown::new(arguments.patterns.clone()),
        publishes: input.is_some(),
        listener: Arc::new(Listener::new(send, input)),
    };
    let mut services = Services::new(robot.clone(), arguments.services);
    let (mut server, inside) = viewers.start(services.offered()).await?;
    let (current, address) = watch::channel(inside);
    let (ended, mut has_ended) = mpsc::channel(1);
    tokio::spawn(gate.serve(Inside { address, ended }));
    rect_terminal::errln!(
        "rect: open ws://{at} in a viewer, as `Foxglove WebSocket`; press Ctrl-C to stop"
    );
    if !at.ip().is_loopback() {
        rect_terminal::errln!(
            "rect: every computer that reaches {at} sees the messages: there is no login"
        );
    }
    let (context, patterns) = (viewers.context.clone(), arguments.patterns);
    let mut logs = Logs::new(robot.clone(), context.clone(), patterns.clone());
    let mut live = Live::new(robot.clone(), context, patterns);
    let mut asking = JoinSet::<Result<Answers, Failure>>::new();
    let mut values = None;
    let mut tick = interval(UPDATED_EVERY);
    let mut ask_at = Instant::now();
    while !robot.is_closed() {
        tokio::select! {
            Some(event) = events.recv() => {
                logs.on_event(&event);
                live.on_event(event);
            }
            Some(message) = next(values.as_ref()) => {
                server.publish_parameter_values(viewers.shown.on_message(message));
            }
            Some(address) = has_ended.recv() => if address == *current.borrow() {
                match viewers.start(services.offered()).await {
                    Ok((again, address)) => {
                        tracing::warn!("the server for viewers has ended, and was started again");
                        std::mem::replace(&mut server, again).stop().detach_all();
                        current.send_replace(address);
                    }
                    Err(error) => tracing::warn!("cannot start the server for viewers again: {error}"),
                }
            },
            Some(found) = asking.join_next() => match found? {
                Ok(Answers { topics: found, parameters, services: served }) => {
                    // The first question makes a router count messages.
                    let counts = found.iter().all(|(_, topics)| topics.window_s > 0.0);
                    ask_at = Instant::now() + if counts { ASKED_EVERY } else { COUNTED };
                    live.on_topics(&found);
                    logs.on_topics(&found);
                    services.on_found(served, &server)?;
                    let mut graph = live.graph();
                    services.add_to(&mut graph);
                    server.publish_connection_graph(graph)?;
                    server.publish_parameter_values(parameters);
                }
                Err(error) => {
                    ask_at = Instant::now() + ASKED_EVERY;
                    tracing::warn!("{error}");
                }
            },
            _ = tick.tick() => {}
        }
        // Nobody is asked while no viewer is connected.
        match (server.client_count(), &values) {
            (0, _) => values = None,
            (_, None) => values = Some(Shown::subscribe(&robot).await?),
            _ => {}
        }
        if server.client_count() > 0 && asking.is_empty() && Instant::now() >= ask_at {
            let robot = robot.clone();
            asking.spawn(async move {
                let topics = query(&robot, None, None, KEPT).await?;
                let names = topics.iter().map(|(robot, _)| Name::new(robot));
                let robots: Vec<_> = names.filter_map(Result::ok).collect();
                Ok(Answers {
                    services: services::find(&robot, robots).await?,
                    parameters: parameters::connections(&robot).await?,
                    topics,
                })
            });
        }
        live.update().await?;
        logs.update().await?;
    }
    rect_terminal::errln!("rect: the router has ended the connection");
    Ok(ExitCode::FAILURE)
}

/// Waits for the next values of a group of parameters.
async fn next(values: Option<&Subscriber<Snapshot>>) -> Option<Message<Snapshot>> {
    match values {
        Some(values) => values.next().await,
        None => std::future::pending().await,
    }
}

/// The answers of the routers.
struct Answers {
    topics: Vec<(String, Topics)>,
    parameters: Vec<Parameter>,
    services: Found,
}

/// The offer of the server to viewers.
struct Viewers {
    robot: Robot,
    context: Arc<Context>,
    listener: Arc<Listener>,
    shown: Shown,
    publishes: bool,
}

impl Viewers {
    /// Starts the server, and returns its address, which is for the gate alone.
    ///
    /// # Errors
    /// Fails if the system has no port for it.
    async fn start(
        &self,
        services: Vec<Service>,
    ) -> Result<(WebSocketServerHandle, SocketAddr), FoxgloveError> {
        // A service may be found later.
        let mut capabilities = vec![Capability::ConnectionGraph, Capability::Services];
        if self.publishes {
            capabilities.push(Capability::ClientPublish);
        }
        let address = gate::hidden_address();
        let parameters = Parameters::new(self.robot.clone(), self.shown.clone(), self.publishes);
        let server = WebSocketServer::new()
            .name(format!("RECT, fleet {}", self.robot.fleet()))
            .bind(address.to_string(), 0)
            .context(&self.context)
            .capabilities(capabilities)
            .supported_encodings(["json"])
            .services(services)
            .parameter_handler(Arc::new(parameters))
            .message_backlog_size(BACKLOG)
            .listener(self.listener.clone())
            .start()
            .await?;
        let address = SocketAddr::new(address.into(), server.port());
        Ok((server, address))
    }
}
