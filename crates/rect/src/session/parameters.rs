//! Declares groups of parameters, which people tune while the program runs, and changes those of other programs.
mod group;
mod options;
mod order;

pub use group::ParameterGroup;
pub use options::{GroupOptions, ParameterField, Parameters};
pub use order::ParameterOrder;
