//! Contains uPlot, which draws the plots of the dashboard, for other pages.

/// The script.
pub const SCRIPT: &str = include_str!("../page/uPlot.iife.min.js");
/// The style sheet.
pub const STYLE: &str = include_str!("../page/uPlot.min.css");
