//! Owns `rect connect` and `rect disconnect`: the named connections of a robot's router.
use std::process::ExitCode;

use clap::Args;
use rect::{core::display::line, Name, NamedConnection};
use serde_json::Value;

use crate::{
    session::{name, JoinArguments},
    Done,
};

/// Give a robot's router a connection; it stays until `rect disconnect`, through restarts.
#[derive(Args)]
pub struct ConnectArguments {
    /// What programs call it
    name: String,
    /// ble, tcp, udp, or any other of Zenoh's protocols
    method: String,
    /// For ble a robot's name or its Bluetooth address, else a host
    address: String,
    /// For tcp, udp and others with one
    #[arg(long)]
    port: Option<u16>,
    /// For ble: the L2CAP channel's number [default: the advertised one]
    #[arg(long)]
    psm: Option<u16>,
    /// Of the method, may be repeated: mtu=512
    #[arg(long = "option", value_name = "KEY=VALUE", value_parser = option)]
    options: Vec<(String, Value)>,
    #[command(flatten)]
    at: AtArguments,
}

/// Take a connection from a robot's router; its link ends.
#[derive(Args)]
pub struct DisconnectArguments {
    /// What it is called
    name: String,
    #[command(flatten)]
    at: AtArguments,
}

#[derive(Args)]
struct AtArguments {
    /// Whose router; another one's access control has to allow that [default: this robot's]
    #[arg(long, value_parser = name)]
    robot: Option<Name>,
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect connect`.
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
    let whose = at.robot.unwrap_or_else(|| robot.name().clone());
    robot.add_connection_of(&whose, &connection).await?;
    rect::outln!(
        "{whose} has the connection {}; `rect connections` shows its state",
        line(&name)
    );
    Ok(ExitCode::SUCCESS)
}

/// `rect disconnect`.
pub async fn disconnect(arguments: DisconnectArguments) -> Done {
    let DisconnectArguments { name, at } = arguments;
    let robot = at.join.join().await?;
    let whose = at.robot.unwrap_or_else(|| robot.name().clone());
    robot.remove_connection_of(&whose, &name).await?;
    rect::outln!("{whose} has the connection {} no more", line(&name));
    Ok(ExitCode::SUCCESS)
}

fn option(text: &str) -> Result<(String, Value), String> {
    let (key, value) = text.split_once('=').ok_or("KEY=VALUE")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    Ok((key.to_owned(), value))
}
