//! Syntax of patterns of ROS names.

/// Maximum length of a pattern in bytes.
const MAX_PATTERN: usize = 253;

/// Checks that a text is a pattern: a name with a leading slash, where `*` stands for any
/// characters within a segment, and a segment `**` for any number of segments. The error is for
/// people.
pub fn check(text: &str) -> Result<(), String> {
    let good = |segment: &str| {
        segment == "**" || !segment.is_empty() && !segment.contains("**") && segment.chars().all(is_part)
    };
    let well_formed = text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(good));
    if well_formed && text.len() <= MAX_PATTERN {
        return Ok(());
    }
    let text: String = text.chars().take(64).collect();
    Err(format!(
        "{text:?} is no pattern of names: write a name with a leading slash, in which * stands for any characters \
         between two slashes and /** for any number of segments, such as /camera/** or /*/odom"
    ))
}

fn is_part(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '*')
}
