//! The rule for automatic connections.
use serde::{Deserialize, Serialize};

/// Maximum of `auto_links`: the number of links that a controller supports.
pub const MAX_AUTO_LINKS: usize = 7;

/// The robots that this robot connects to automatically.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AutoConnect {
    /// No robot: the router only accepts links.
    None,
    /// The entries of the connections file.
    #[default]
    Listed,
    /// The entries of the connections file and robots of the fleet that are discovered by Bluetooth.
    Fleet,
}

impl AutoConnect {
    /// Parses `none`, `listed` or `fleet`; `None` for any other text.
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_value(text.into()).ok()
    }
}

/// The rule for automatic connections, from the settings or from the connections file, which overrides them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AutoConnectRule {
    /// Robots to connect to.
    pub auto_connect: AutoConnect,
    /// With [`AutoConnect::Fleet`], the number of links to discovered robots in addition to the listed ones.
    pub auto_links: usize,
}

impl AutoConnectRule {
    /// Returns the number of discovered robots of the fleet to dial.
    pub fn dials(&self) -> usize {
        match self.auto_connect {
            AutoConnect::Fleet => self.auto_links,
            AutoConnect::None | AutoConnect::Listed => 0,
        }
    }
}
