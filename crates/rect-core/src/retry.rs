//! Requests that are repeated until there is a reply, and carried out at most once: [`once`] decides at the service, and
//! [`request`] at the requester.
//!
//! Such a request names the run of the program that may carry it out. That run carries it out once and repeats its first reply; every
//! other run, such as the same program after a restart, refuses it. So the requester either gets the reply, or learns that it will
//! get none.
pub mod once;
pub mod request;
#[cfg(test)]
mod tests;
