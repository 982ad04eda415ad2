//! Implements `rect recording`, which works on recordings.
mod fetch;

use std::{
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use clap::{Args, Subcommand, ValueEnum};
use rect_core::{
    storage::regular_file,
    text::{display::line, humanize},
};
use rect_recording::{
    export::{Exporter, Format},
    merge::merge,
    pictures::Pictures,
    Entry, EntryPattern, Extras, Missing, ReadError, Reader, Selection, Summary,
};
use rect_terminal::{self as terminal, paint, Cell, Style, Table};

use crate::{duration::DurationArgument, Done, Failure};

/// Show, check, convert, cut, merge and repair recordings, and fetch them from robots
#[derive(Args)]
pub struct RecordingArguments {
    #[command(subcommand)]
    command: RecordingCommand,
}

#[derive(Subcommand)]
enum RecordingCommand {
    /// Show the topics of a recording, and how many messages each of them has
    Info {
        /// The file, or the folder of an interrupted recording
        recording: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Read a whole recording. Exit status 1: it is damaged or was interrupted
    Check {
        /// The file, or the folder of an interrupted recording
        recording: PathBuf,
    },
    /// Convert a recording for other programs
    Export {
        /// The file, or the folder of an interrupted recording
        recording: PathBuf,
        /// `jsonl`: an object for each message; `csv`: a row for each number or text; `pictures`: a file for each picture
        #[arg(long, value_enum)]
        format: ExportFormat,
        /// The file to write [default: the output], or the folder of the pictures
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        #[command(flatten)]
        part: PartArguments,
    },
    Fetch(fetch::FetchArguments),
    /// Write a part of a recording to a new file, with the metadata and attachments of other programs
    Cut {
        /// The file, or the folder of an interrupted recording
        recording: PathBuf,
        /// The file to write
        #[arg(short, long, value_name = "FILE")]
        output: PathBuf,
        #[command(flatten)]
        part: PartArguments,
    },
    /// Write recordings, such as those of several robots or an interrupted one, to one new file, in the order of their times
    Merge {
        /// The files or folders
        #[arg(required = true)]
        recordings: Vec<PathBuf>,
        /// The file to write
        #[arg(short, long, value_name = "FILE")]
        output: PathBuf,
    },
    /// Write everything that is whole of a damaged recording to a new file, and report what is missing
    Recover {
        /// The file, or the folder of an interrupted recording
        recording: PathBuf,
        /// The file to write
        #[arg(short, long, value_name = "FILE")]
        output: PathBuf,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ExportFormat {
    Jsonl,
    Csv,
    Pictures,
}

/// The part of a recording.
#[derive(Args, Clone, Debug)]
pub struct PartArguments {
    /// Only these messages, <robot>/<topic> with wildcards; /<topic> for those of other programs, such as /left/*
    #[arg(long = "topic", value_name = "PATTERN")]
    patterns: Vec<EntryPattern>,
    /// Begin at this time after the start, such as 90s
    #[arg(long = "from", value_name = "TIME", default_value = "0s")]
    begin: DurationArgument,
    /// End at this time after the start [default: the end]
    #[arg(long = "until", value_name = "TIME")]
    end: Option<DurationArgument>,
}

impl PartArguments {
    /// Returns the selection.
    pub fn selection(&self) -> Selection {
        Selection {
            patterns: self.patterns.clone(),
            begin: self.begin.0,
            end: self.end.map(|end| end.0),
        }
    }
}

/// Runs `rect recording`.
pub fn run(arguments: RecordingArguments) -> Done {
    match arguments.command {
        RecordingCommand::Fetch(arguments) => crate::wait(fetch::run(arguments)),
        RecordingCommand::Info { recording, json } => info(&recording, json),
        RecordingCommand::Check { recording } => check(&recording),
        RecordingCommand::Export {
            recording,
            format,
            output,
            part,
        } => export(&recording, format, output.as_deref(), &part),
        RecordingCommand::Cut {
            recording,
            output,
            part,
        } => {
            let selected = part.selection().of(Reader::open(&recording)?);
            let extras = Extras::of(&[recording])?;
            written(merge(selected, &output, &extras)?, &output)
        }
        RecordingCommand::Merge { recordings, output } => {
            let readers = recordings.iter().map(|recording| Reader::open(recording));
            let entries = rect_recording::by_time(readers.collect::<Result<_, _>>()?);
            let extras = Extras::of(&recordings)?;
            written(merge(entries, &output, &extras)?, &output)
        }
        RecordingCommand::Recover { recording, output } => recover(&recording, &output),
    }
}

fn recover(recording: &Path, output: &Path) -> Done {
    let (extras, mut missing) = Extras::of_damaged(recording)?;
    let mut reader = Reader::open_damaged(recording)?;
    let mut entries = reader.by_ref().peekable();
    let started = match entries.peek() {
        Some(Ok(first)) => first.logged,
        Some(Err(_)) => Duration::ZERO,
        None => {
            let name = recording.display();
            return Err(
                format!("no message in {name} is whole: there is nothing to recover").into(),
            );
        }
    };
    let count = merge(entries, output, &extras)?;
    missing.extend_from_slice(reader.missing());
    for part in &missing {
        rect_terminal::errln!("rect: {}", missing_text(part, started));
    }
    written(count, output)
}

/// Describes what is missing of a recording that started at a time.
fn missing_text(missing: &Missing, started: Duration) -> String {
    let Missing {
        path,
        bytes,
        times,
        reason,
    } = missing;
    let mut text = path.display().to_string();
    if !bytes.is_empty() {
        let size = bytes.end - bytes.start;
        text += &format!(": {size} bytes at byte {} are missing", bytes.start);
    }
    if let Some((first, last)) = times {
        let after = |time: &Duration| time.saturating_sub(started).as_secs_f64();
        let (first, last) = (after(first), after(last));
        text += &format!(", with messages from {first:.1} s to {last:.1} s after the start");
    }
    text + ": " + reason
}

fn written(count: u64, output: &Path) -> Done {
    rect_terminal::outln!("{}: {count} messages", output.display());
    Ok(ExitCode::SUCCESS)
}

fn info(recording: &Path, json: bool) -> Done {
    let (summary, error) = Summary::read(Reader::open(recording)?);
    if json {
        terminal::json(&summary)?;
    } else {
        print(&summary);
    }
    finished(&summary, error)
}

fn print(summary: &Summary) {
    for (name, value) in &summary.about {
        rect_terminal::outln!("{} {}", paint(Style::Name, &line(name)), line(value));
    }
    let duration = humanize::duration_of_s(summary.duration_s);
    let size = humanize::bytes(summary.bytes);
    let reports = match summary.reports {
        0 => String::new(),
        reports => format!(", and {reports} reports of events, links and requests"),
    };
    let lines = match summary.log_lines {
        0 => String::new(),
        1 => ", and 1 log line".to_owned(),
        lines => format!(", and {lines} log lines"),
    };
    rect_terminal::outln!(
        "{} messages in {duration}, {size}{reports}{lines}",
        summary.messages
    );
    let mut table = Table::new(&["TOPIC", "ENCODING", "MESSAGES", "BYTES", "RATE", "MISSED"]);
    for (topic, of_topic) in &summary.topics {
        let rate = match summary.duration_s > 0.0 {
            true => format!("{:.1}/s", of_topic.messages as f64 / summary.duration_s),
            false => "-".to_owned(),
        };
        table.row(vec![
            Cell::styled(Style::Name, line(topic)),
            line(&of_topic.encoding).into_owned().into(),
            of_topic.messages.to_string().into(),
            humanize::bytes(of_topic.bytes).into(),
            rate.into(),
            of_topic.missed.to_string().into(),
        ]);
    }
    table.print();
}

fn check(recording: &Path) -> Done {
    let (summary, error) = Summary::read(Reader::open(recording)?);
    let is_whole = error.is_none() && summary.is_complete;
    if is_whole {
        rect_terminal::outln!("ok: {} messages", summary.messages);
        return Ok(ExitCode::SUCCESS);
    }
    finished(&summary, error)?;
    Ok(ExitCode::FAILURE)
}

/// Reports what is wrong with a recording, if anything is.
fn finished(summary: &Summary, error: Option<ReadError>) -> Done {
    if let Some(error) = error {
        return Err(error.into());
    }
    if !summary.is_complete {
        rect_terminal::errln!(
            "rect: the recording was interrupted; the {} messages before that are whole. `rect recording merge` writes them to a \
             complete file",
            summary.messages
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn export(
    recording: &Path,
    format: ExportFormat,
    output: Option<&Path>,
    part: &PartArguments,
) -> Done {
    let entries = part.selection().of(Reader::open(recording)?);
    let format = match format {
        ExportFormat::Jsonl => Format::JsonLines,
        ExportFormat::Csv => Format::Csv,
        ExportFormat::Pictures => {
            let folder = output.ok_or("--output names the folder of the pictures")?;
            return pictures(entries, folder);
        }
    };
    match output {
        Some(path) => {
            let file =
                regular_file::create_new(path).map_err(|error| cannot_write(path, &error))?;
            exported(entries, format, BufWriter::new(file))
        }
        None => match exported(entries, format, io::stdout().lock()) {
            // The reader of the output has enough.
            Err(error) if is_closed_pipe(error.as_ref()) => Ok(ExitCode::SUCCESS),
            done => done,
        },
    }
}

fn pictures(entries: impl Iterator<Item = Result<Entry, ReadError>>, folder: &Path) -> Done {
    let created = Pictures::create(folder.to_owned());
    let mut pictures = created.map_err(|error| cannot_write(folder, &error))?;
    for entry in entries {
        let written = pictures.add(&entry?);
        written.map_err(|error| cannot_write(folder, &error))?;
    }
    rect_terminal::outln!("{}: {} pictures", folder.display(), pictures.written());
    Ok(ExitCode::SUCCESS)
}

fn exported(
    entries: impl Iterator<Item = Result<Entry, ReadError>>,
    format: Format,
    to: impl Write,
) -> Done {
    let mut exporter = Exporter::new(format, to)?;
    for entry in entries {
        exporter.add(&entry?)?;
    }
    exporter.finish()?;
    Ok(ExitCode::SUCCESS)
}

fn is_closed_pipe(error: &(dyn std::error::Error + 'static)) -> bool {
    let error = error.downcast_ref::<io::Error>();
    error.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

fn cannot_write(path: &Path, error: &io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::AlreadyExists => {
            format!("{} exists already: choose another name", path.display())
        }
        _ => format!("cannot write {}: {error}", path.display()),
    }
    .into()
}
