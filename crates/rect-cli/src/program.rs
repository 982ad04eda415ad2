//! Implements `rect program` and `rect service`, which show what runs on robots and what it offers.
use std::process::ExitCode;

use clap::{Args, Subcommand};
use rect::{Error, Name, Program};
use rect_dashboard::programs;
use rect_terminal::{self as terminal, Cell, Style, Table};
use serde_json::json;

use crate::{log, session::ListArguments, Done};

/// Show the programs that run on robots, and what they have logged
#[derive(Args)]
pub struct ProgramArguments {
    #[command(subcommand)]
    command: ProgramCommand,
}

#[derive(Subcommand)]
enum ProgramCommand {
    /// List the programs of a robot, or of all robots of the fleet
    List(ListArguments),
    Log(log::ProgramLogArguments),
}

/// Show the services that robots offer
#[derive(Args)]
pub struct ServiceArguments {
    #[command(subcommand)]
    command: ServiceCommand,
}

#[derive(Subcommand)]
enum ServiceCommand {
    /// List the services of a robot, or of all robots of the fleet
    List(ListArguments),
}

/// Runs `rect program`.
pub async fn programs(arguments: ProgramArguments) -> Done {
    let arguments = match arguments.command {
        ProgramCommand::List(arguments) => arguments,
        ProgramCommand::Log(arguments) => return log::run_program(arguments).await,
    };
    list(arguments, |catalogues| {
        let mut table = Table::new(&["PROGRAM", "SERVICES"]);
        for (robot, programs) in catalogues {
            for program in programs {
                let topics: Vec<_> = (program.requestable())
                    .map(|service| service.topic.as_str())
                    .collect();
                let topics = if topics.is_empty() {
                    "-".to_owned()
                } else {
                    topics.join(", ")
                };
                table.row(vec![title(robot, program), topics.into()]);
            }
        }
        table.print();
    })
    .await
}

/// Runs `rect service`.
pub async fn services(arguments: ServiceArguments) -> Done {
    let ServiceCommand::List(arguments) = arguments.command;
    list(arguments, |catalogues| {
        let mut table = Table::new(&["SERVICE", "PROGRAM", "?ABOUT"]);
        for (robot, programs) in catalogues {
            for program in programs {
                for service in program.requestable() {
                    table.row(vec![
                        Cell::styled(Style::Name, format!("{robot}/{}", service.topic)),
                        program.name.as_ref().map_or("-", Name::as_str).into(),
                        service.about.as_str().into(),
                    ]);
                }
            }
        }
        table.print();
    })
    .await
}

fn title(robot: &Name, program: &Program) -> Cell {
    let name = program.name.as_ref().map_or("-", Name::as_str);
    Cell::styled(Style::Name, format!("{robot}/{name}"))
}

/// Asks one robot or all, and prints their catalogues. Robots that do not answer are reported on standard error.
async fn list(arguments: ListArguments, print: impl FnOnce(&[(Name, Vec<Program>)])) -> Done {
    let own = arguments.join.join_unnamed().await?;
    let mut catalogues = Vec::new();
    match arguments.robot {
        Some(robot) => {
            let programs = own.programs(&robot).await?;
            catalogues.push((robot, programs));
        }
        None => {
            let mut robots = own.peers().await?;
            robots.push(own.name().clone());
            for (robot, answer) in programs::query(&own, robots).await {
                match answer {
                    Ok(programs) => catalogues.push((robot, programs)),
                    // This computer may be no robot.
                    Err(Error::NoService { .. }) if robot == *own.name() => {}
                    Err(error) => rect_terminal::errln!("rect: {robot}: {error}"),
                }
            }
        }
    }
    if arguments.json {
        let all = catalogues
            .iter()
            .map(|(robot, programs)| (robot.to_string(), json!(programs)));
        terminal::json(&all.collect::<serde_json::Map<_, _>>())?;
    } else {
        print(&catalogues);
    }
    Ok(ExitCode::SUCCESS)
}
