//! Keeps the values of a group.
use super::{Declaration, Parameter, Value};

/// The values of a group, in the order of the declaration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values(Vec<Value>);

impl Values {
    pub(super) fn defaults(declaration: &Declaration) -> Self {
        let parameters = declaration.parameters().iter();
        Self(
            parameters
                .map(|parameter| parameter.default.clone())
                .collect(),
        )
    }

    /// Returns the values, in the order of the declaration.
    pub fn iter(&self) -> impl Iterator<Item = &Value> {
        self.0.iter()
    }

    /// Returns each parameter with its value.
    pub fn of<'a>(
        &'a self,
        declaration: &'a Declaration,
    ) -> impl Iterator<Item = (&'a Parameter, &'a Value)> {
        declaration.parameters().iter().zip(&self.0)
    }

    pub(super) fn replace(&mut self, declaration: &Declaration, name: &str, value: Value) {
        let mut parameters = declaration.parameters().iter();
        if let Some(at) = parameters.position(|parameter| parameter.name == name) {
            self.0[at] = value;
        }
    }
}
