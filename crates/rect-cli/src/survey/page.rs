//! Writes the page with plots: one file that needs no others.
use rect_dashboard::plot;

use serde_json::json;

use super::{document::Survey, expected};

const PAGE: &str = include_str!("page/survey.html");
const SCRIPT: &str = include_str!("page/survey.js");
const STYLE: &str = include_str!("page/survey.css");

/// Returns the page of a survey.
pub fn html(survey: &Survey) -> serde_json::Result<String> {
    let data = json!({ "survey": survey, "expected": expected::curves()? });
    // The data contains texts of the other robot: no `<` may end the element that contains it.
    let data = data.to_string().replace('<', "\\u003c");
    let parts = [
        ("{{style}}", plot::STYLE.to_owned() + STYLE),
        ("{{plot}}", plot::SCRIPT.to_owned()),
        ("{{script}}", SCRIPT.to_owned()),
        // The last one, since its texts are replaced by none of the others.
        ("{{data}}", data),
    ];
    let replace = |page: String, (name, text): (&str, String)| page.replace(name, &text);
    Ok(parts.into_iter().fold(PAGE.to_owned(), replace))
}
