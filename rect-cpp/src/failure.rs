//! Owns what can go wrong at this border: the codes that C gets, and their texts.
use rect::{
    core::{
        codec::CodecError, dictionary::DictionaryError, name::NameError, payload::PayloadError,
        topic::TopicError, transfer::OfferError, wording,
    },
    Error,
};

/// How a call ended. All but RECT_CODE_OK and RECT_CODE_END come with a text that says what to do.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    /// It is done.
    Ok = 0,
    /// There are no more: all have answered.
    End = 1,
    /// It took longer than was allowed. Ask again, allow more time, or look at the link (`rect connections`).
    TimedOut = 2,
    /// An argument is NULL, not UTF-8, or out of its range; the text names it.
    Argument = 3,
    /// What the handle was for has been dropped, or it is a handle of something else.
    Handle = 4,
    /// The session was closed, or what is waited for was dropped meanwhile.
    Closed = 5,
    /// The name of a robot or fleet. Choose another.
    Name = 6,
    /// A topic or pattern. Write it as the text says.
    Topic = 7,
    /// A value that can't be sent or read as asked for.
    Payload = 8,
    /// A codec that does not fit, or a payload that is damaged.
    Codec = 9,
    /// Bytes that are no dictionary, or samples that make none.
    Dictionary = 10,
    /// No router. Start one, or name another.
    NoRouter = 11,
    /// A locator, or something else in the options, that Zenoh does not take.
    Option = 12,
    /// Nobody has that service. Is the robot there, and does its program run?
    NoService = 13,
    /// The service answered with an error.
    Service = 14,
    /// Zenoh refuses.
    Zenoh = 15,
    /// A transfer is not taken there.
    TransferRefused = 16,
    /// A transfer began and ended before all was there. The text says whether to send it again.
    TransferFailed = 17,
    /// A file or folder of a transfer can't be used.
    File = 18,
    /// A fault of RECT's own: please report it with its text.
    Fault = 19,
    /// A failure that this version of the header has no word for; the text tells.
    Other = 20,
    /// The router asks for a login, and this program's is missing or wrong. Name the team's login file.
    LoginRefused = 21,
    /// The router serves another robot than the program joins as. Join under that name, or at the right router.
    WrongRobot = 22,
}

/// Why a call did not do it.
#[derive(Debug)]
pub enum Failure {
    /// The library's.
    Rect(Error),
    /// A dictionary.
    Dictionary(DictionaryError),
    /// An argument: which, and what is wrong with it.
    Argument(&'static str, String),
    /// A handle that is not of what it is to be: what is wanted.
    Handle(&'static str),
    /// Nothing came within the time, in ms.
    TimedOut(&'static str, u32),
    /// What was waited for is gone.
    Closed,
    /// There is no more.
    End,
    /// No thread can be started, or the like.
    System(&'static str, std::io::Error),
    /// A panic, and what it says.
    Fault(String),
}

impl Failure {
    /// An argument, and what is wrong with it.
    pub fn argument(name: &'static str, wrong: impl Into<String>) -> Self {
        Self::Argument(name, wrong.into())
    }

    /// For C.
    pub fn code(&self) -> Code {
        match self {
            Self::Rect(error) => code(error),
            Self::Dictionary(_) => Code::Dictionary,
            Self::Argument(..) => Code::Argument,
            Self::Handle(_) => Code::Handle,
            Self::TimedOut(..) => Code::TimedOut,
            Self::Closed => Code::Closed,
            Self::End => Code::End,
            Self::System(..) => Code::Other,
            Self::Fault(_) => Code::Fault,
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        match self {
            Self::Rect(error) => wording::with_causes(error),
            Self::Dictionary(error) => wording::with_causes(error),
            Self::Argument(name, wrong) => format!("the argument {name} {wrong}"),
            Self::Handle(kind) => format!(
                "this is no handle of a {kind} that is there: it was dropped already, never made, or is of something else"
            ),
            Self::TimedOut(what, ms) => format!("no {what} within {ms} ms"),
            Self::Closed => "the session is closed, or what was waited for was dropped".to_owned(),
            Self::End => "there are no more".to_owned(),
            Self::System(what, error) => format!("{what}: {error}"),
            Self::Fault(said) => format!("a fault of RECT's own, please report it: {said}"),
        }
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
        Error::NoService { .. } => Code::NoService,
        Error::TimedOut { .. } => Code::TimedOut,
        Error::Service { .. } => Code::Service,
        Error::Zenoh { .. } => Code::Zenoh,
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

macro_rules! of_the_library {
    ($($error:ty),*) => {
        $(impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Rect(error.into())
            }
        })*
    };
}

of_the_library!(NameError, TopicError, PayloadError, CodecError, OfferError);
