//! Implements `rect param`, which shows and changes the parameters of programs: values that people tune while the programs run. The
//! programs decide what they accept.
mod change;
mod export;
pub mod groups;
mod import;
mod list;
mod place;
mod profile;

use clap::{Args, Subcommand};

use crate::Done;

/// Show and change the parameters of programs, such as a gain or a speed limit
#[derive(Args)]
pub struct ParamArguments {
    #[command(subcommand)]
    command: ParamCommand,
}

#[derive(Subcommand)]
enum ParamCommand {
    List(list::ListArguments),
    Get(list::GetArguments),
    Set(change::SetArguments),
    Reset(change::ResetArguments),
    Export(export::ExportArguments),
    Import(import::ImportArguments),
}

/// Runs `rect param`.
pub async fn run(arguments: ParamArguments) -> Done {
    match arguments.command {
        ParamCommand::List(arguments) => list::list(arguments).await,
        ParamCommand::Get(arguments) => list::get(arguments).await,
        ParamCommand::Set(arguments) => change::set(arguments).await,
        ParamCommand::Reset(arguments) => change::reset(arguments).await,
        ParamCommand::Export(arguments) => export::run(arguments).await,
        ParamCommand::Import(arguments) => import::run(arguments).await,
    }
}
