//! Implements `rect connect` and `rect disconnect`, which change the named connections of a robot's router.
use std::process::ExitCode;

use clap::Args;
use rect::{Name, NamedConnection};
use rect_core::text::display::line;
use serde_json::Value;

use crate::{
    session::{name, JoinArguments},
    Done,
};

/// Add a named connection to a robot's router; it remains until `rect disconnect`, also after restarts
#[derive(Args)]
pub struct ConnectArguments {
    /// The name of the connection
    name: String,
    /// ble, tcp, udp, or another link protocol of Zenoh
    method: String,
    /// For ble the name or Bluetooth address of a robot, otherwise a host
    address: String,
    /// The port, for tcp, udp and other methods with ports
    #[arg(long)]
    port: Option<u16>,
    /// The PSM of the L2CAP channel, for ble [default: the advertised one]
    #[arg(long)]
    psm: Option<u16>,
    /// An option of the method, such as mtu=512; may be repeated
    #[arg(long = "option", value_name = "KEY=VALUE", value_parser = option)]
    options: Vec<(String, Value)>,
    #[command(flatten)]
    at: AtArguments,
}

/// Remove a named connection from a robot's router, and close its link
#[derive(Args)]
pub struct DisconnectArguments {
    /// The name of the connection
    name: String,
    #[command(flatten)]
    at: AtArguments,
}

#[derive(Args)]
struct AtArguments {
    /// The robot of the router; the access control of another robot must permit changes [default: this robot]
    #[arg(long, value_parser = name)]
    robot: Option<Name>,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect connect`.
pub async fn connect(arguments: ConnectArguments) -> Done {
    let ConnectArguments {
        name,
        method,
        address,
        port,
        psm,
        options,
        at,
    } = arguments;
    let mut connection = NamedConnection::new(&name, method, address);
    connection = port.into_iter().fold(connection, NamedConnection::port);
    connection = psm.into_iter().fold(connection, NamedConnection::psm);
    for (key, value) in options {
        connection = connection.option(key, value);
    }
    let robot = at.join.join().await?;
    let owner = at.robot.unwrap_or_else(|| robot.name().clone());
    robot.add_connection_of(&owner, &connection).await?;
    rect_terminal::outln!(
        "{owner} has the connection {} now; `rect connections` shows its state",
        line(&name)
    );
    Ok(ExitCode::SUCCESS)
}

/// Runs `rect disconnect`.
pub async fn disconnect(arguments: DisconnectArguments) -> Done {
    let DisconnectArguments { name, at } = arguments;
    let robot = at.join.join().await?;
    let owner = at.robot.unwrap_or_else(|| robot.name().clone());
    robot.remove_connection_of(&owner, &name).await?;
    rect_terminal::outln!("removed the connection {} of {owner}", line(&name));
    Ok(ExitCode::SUCCESS)
}

fn option(text: &str) -> Result<(String, Value), String> {
    let (key, value) = text.split_once('=').ok_or("write KEY=VALUE")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    Ok((key.to_owned(), value))
}
