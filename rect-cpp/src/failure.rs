//! Lists the failures of the C interface: the codes that C receives, their texts and their causes.
use rect::Error;
use rect_core::{
    codec::{dictionary::DictionaryError, CodecError},
    message::payload::PayloadError,
    name::{topic::TopicError, NameError},
    text::humanize,
    transfer::OfferError,
};

/// The result of a call. For every code except `RECT_CODE_OK`, `rect_error.text` describes what happened and what to do.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// The call succeeded.
    Ok = 0,
    /// There are no more items: all robots have replied, or the end of the transfer has already been reported.
    End = 1,
    /// The timeout expired. Try again, allow more time, or check the link with `rect connections`.
    TimedOut = 2,
    /// An argument is NULL, is not UTF-8, or is out of range. The text names the argument.
    Argument = 3,
    /// The handle was already dropped, or belongs to an object of another kind.
    Handle = 4,
    /// The session was closed, or another thread dropped the object while the call was waiting.
    Closed = 5,
    /// The name of a robot or fleet, or the file name of a transfer, is invalid. Choose another one.
    Name = 6,
    /// A topic or pattern is invalid. The text explains the rule that it breaks.
    Topic = 7,
    /// A value cannot be sent, or a payload cannot be read as the requested type.
    Payload = 8,
    /// A codec does not suit the payload, or the encoded payload is damaged.
    Codec = 9,
    /// The bytes are not a dictionary, or no dictionary can be trained from the samples.
    Dictionary = 10,
    /// There is no router at the endpoint. Start one, or specify another endpoint.
    NoRouter = 11,
    /// A locator or another option is invalid. The text names the option and the values that are allowed.
    Option = 12,
    /// The robot does not offer the service. Check that the robot is reachable and that its program is running.
    NoService = 13,
    /// The service replied with an error, which is the text.
    Service = 14,
    /// Zenoh reported an error.
    Zenoh = 15,
    /// The recipient refused the transfer.
    TransferRefused = 16,
    /// The transfer started and failed before it was complete. The text states whether to send it again.
    TransferFailed = 17,
    /// A file or folder of a transfer cannot be read or written.
    File = 18,
    /// An internal error of RECT. Please report it with its text.
    Internal = 19,
    /// An error without a code in this version of the header. The text describes it.
    Other = 20,
    /// The router requires a login, and the login of this program is missing or wrong. Specify the team's login file.
    LoginRefused = 21,
    /// The router belongs to another robot than the name under which the program connects. Use that robot's name, or connect
    /// to the router of the right robot.
    WrongRobot = 22,
    /// The operating system does not start another thread. Close other programs, or raise the limit of threads.
    Thread = 23,
    /// A recording cannot start, or not become a file. Choose another name, or make room on the disk.
    Recording = 24,
    /// A service may have received the request, and no reply follows: its program, a router or the link ended. It may have been
    /// carried out; ask the robot before you repeat a request that must not be carried out twice.
    Interrupted = 25,
    /// Another program of the robot serves the topic already. The text names it.
    ServiceRefused = 26,
    /// The robot to which a message is sent is not reachable. The text lists the reachable ones. Check the name, or wait for the robot.
    NotReachable = 27,
    /// The value of a retained topic is not kept; the text states why. It was published, unless a program serves the topic.
    NotRetained = 28,
    /// A declaration of parameters is invalid, or one of this program's own values is refused. The text states why.
    Parameters = 29,
    /// No program of the robot has the group of parameters. The text lists its groups. Check that the program is running. A robot that
    /// was configured by an earlier version lacks the rule for `@rect/@set/parameters/**` in its access control.
    NoParameters = 30,
    /// The values of parameters are in force, but are lost when the program of the robot ends. The text states why.
    NotStored = 31,
    /// An action cannot be declared, or an argument of a goal is invalid. The text states why.
    Action = 32,
    /// No program of the robot has the action. The text lists its actions. Check that the program is running. A robot that was configured
    /// by an earlier version lacks the rule for `@rect/@set/actions/**` in its access control.
    NoAction = 33,
    /// The robot does not know the goal: it never began, or ended more than ten minutes ago.
    NoGoal = 34,
    /// A goal was not carried out, or not to its end, or its result cannot be received. The text states how it ended, and why.
    Goal = 35,
    /// The goal was cancelled while the function that carries it out was sleeping. It should end soon.
    Cancelled = 36,
}

/// The reason why a call failed.
#[derive(Debug)]
pub enum Failure {
    /// An error of the Rust library.
    Rect(Error),
    /// An error of a dictionary.
    Dictionary(DictionaryError),
    /// The name of an invalid argument, and what is wrong with it.
    Argument(&'static str, String),
    /// A handle that does not belong to an object of the expected kind, which is given.
    Handle(&'static str),
    /// The awaited item, and the timeout in milliseconds that expired.
    TimedOut(&'static str, u32),
    /// The reason why the function that carries out a goal should end.
    Cancelled(String),
    /// The session was closed, or the object was dropped.
    Closed,
    /// There are no more items.
    End,
    /// The message of a panic.
    Internal(String),
}

impl Failure {
    /// Creates the failure of an invalid argument.
    pub fn argument(name: &'static str, problem: impl Into<String>) -> Self {
        Self::Argument(name, problem.into())
    }

    /// Returns the code for C.
    pub fn code(&self) -> Code {
        match self {
            Self::Rect(error) => code(error),
            Self::Dictionary(_) => Code::Dictionary,
            Self::Argument(..) => Code::Argument,
            Self::Handle(_) => Code::Handle,
            Self::TimedOut(..) => Code::TimedOut,
            Self::Cancelled(_) => Code::Cancelled,
            Self::Closed => Code::Closed,
            Self::End => Code::End,
            Self::Internal(_) => Code::Internal,
        }
    }

    /// Returns the text for people.
    pub fn text(&self) -> String {
        match self {
            Self::Rect(error) => humanize::on_one_line(&error.to_string()),
            Self::Dictionary(error) => humanize::with_causes(error),
            Self::Argument(name, problem) => format!("the argument {name} {problem}"),
            Self::Handle(kind) => format!(
                "invalid handle (expected: {kind}): it was already dropped, was never created, or belongs to an object of another kind"
            ),
            Self::TimedOut(item, ms) => format!("no {item} within {ms} ms"),
            Self::Cancelled(reason) => format!("cancelled: {reason}"),
            Self::Closed => "the session was closed, or the object was dropped while the call was waiting".to_owned(),
            Self::End => "there are no more items".to_owned(),
            Self::Internal(message) => format!("internal error of RECT, please report it: {message}"),
        }
    }

    /// Returns the error of the library, if it has causes.
    pub fn with_causes(&self) -> Option<&(dyn std::error::Error + 'static)> {
        let error: &(dyn std::error::Error + 'static) = match self {
            Self::Rect(error) => error,
            Self::Dictionary(error) => error,
            _ => return None,
        };
        error.source().map(|_| error)
    }
}

fn code(error: &Error) -> Code {
    match error {
        Error::Name(_) | Error::Topic(TopicError::Robot(_)) => Code::Name,
        Error::Topic(_) => Code::Topic,
        Error::Payload(PayloadError::Codec(_)) | Error::Codec(_) => Code::Codec,
        Error::Payload(_) => Code::Payload,
        Error::NoRouter { .. } => Code::NoRouter,
        Error::LoginRefused(_) => Code::LoginRefused,
        Error::WrongRobot(_) => Code::WrongRobot,
        Error::Option { .. } => Code::Option,
        Error::NotReachable { .. } => Code::NotReachable,
        Error::NotRetained { .. } => Code::NotRetained,
        Error::Parameters { .. } => Code::Parameters,
        Error::NoParameters { .. } => Code::NoParameters,
        Error::NotStored { .. } => Code::NotStored,
        Error::Action { .. } => Code::Action,
        Error::NoAction { .. } => Code::NoAction,
        Error::NoGoal { .. } => Code::NoGoal,
        Error::Goal { .. } => Code::Goal,
        Error::NoService { .. } => Code::NoService,
        Error::ServiceRefused { .. } => Code::ServiceRefused,
        Error::Interrupted { .. } => Code::Interrupted,
        Error::TimedOut { .. } => Code::TimedOut,
        Error::Service { .. } => Code::Service,
        Error::Zenoh { .. } => Code::Zenoh,
        Error::Thread { .. } => Code::Thread,
        Error::Recording(_) => Code::Recording,
        Error::Dictionary(_) => Code::Dictionary,
        Error::TransferRefused { .. } => Code::TransferRefused,
        Error::TransferFailed { .. } => Code::TransferFailed,
        Error::File { .. } => Code::File,
        Error::Offer(_) => Code::Name,
        Error::Closed => Code::Closed,
        _ => Code::Other,
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Rect(error)
    }
}

impl From<DictionaryError> for Failure {
    fn from(error: DictionaryError) -> Self {
        Self::Dictionary(error)
    }
}

macro_rules! impl_from_library_error {
    ($($error:ty),*) => {
        $(impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Rect(error.into())
            }
        })*
    };
}

impl_from_library_error!(NameError, TopicError, PayloadError, CodecError, OfferError);
