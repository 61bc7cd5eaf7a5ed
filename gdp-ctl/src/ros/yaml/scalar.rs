//! Text in YAML: plain where it reads as the same text, otherwise in quotes. The rules are those of
//! PyYAML's `Emitter.analyze_scalar` and of the resolver of YAML 1.1, whose `on`, `1:20` and
//! `2026-11-22` are no text.

use std::sync::LazyLock;

use regex_lite::Regex;

/// Plain text that is taken for something else.
static OTHER: LazyLock<Regex> = LazyLock::new(|| {
    let kinds = [
        // bool
        "yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF",
        // float
        r"[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?",
        r"\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?",
        r"[-+]?[0-9][0-9_]*(?::[0-5]?[0-9])+\.[0-9_]*",
        r"[-+]?\.(?:inf|Inf|INF)",
        r"\.(?:nan|NaN|NAN)",
        // int
        "[-+]?0b[0-1_]+|[-+]?0[0-7_]+|[-+]?(?:0|[1-9][0-9_]*)|[-+]?0x[0-9a-fA-F_]+|[-+]?[1-9][0-9_]*(?::[0-5]?[0-9])+",
        // merge, null, value
        "<<|~|null|Null|NULL||=",
        // timestamp
        "[0-9]{4}-[0-9]{2}-[0-9]{2}",
        r"[0-9]{4}-[0-9][0-9]?-[0-9][0-9]?(?:[Tt]|[ \t]+)[0-9][0-9]?:[0-9]{2}:[0-9]{2}(?:\.[0-9]*)?(?:[ \t]*(?:Z|[-+][0-9][0-9]?(?::[0-9]{2})?))?",
    ];
    Regex::new(&format!("^(?:{})$", kinds.join("|"))).expect("a constant")
});

/// `indent`: of lines behind the first.
pub fn text(value: &str, indent: usize) -> String {
    let allowed = Allowed::of(value);
    if allowed.plain && !OTHER.is_match(value) {
        value.to_owned()
    } else if allowed.single {
        single(value, indent)
    } else {
        double(value)
    }
}

struct Allowed {
    plain: bool,
    single: bool,
}

impl Allowed {
    fn of(value: &str) -> Self {
        let mut indicators = value.starts_with("---") || value.starts_with("...");
        let (mut breaks, mut special) = (false, false);
        let (mut break_space, mut space_break) = (false, false);
        // Whether the character before is a space, a break, or white space at all.
        let (mut behind_space, mut behind_break, mut behind_white) = (false, false, true);
        let mut rest = value.chars().enumerate().peekable();
        while let Some((at, c)) = rest.next() {
            let before_white = rest.peek().is_none_or(|(_, next)| is_white(*next));
            indicators |= match c {
                '#' => behind_white,
                ',' | '[' | ']' | '{' | '}' | '&' | '*' | '!' | '|' | '>' | '\'' | '"' | '%' | '@' | '`' => at == 0,
                ':' => before_white,
                '?' | '-' => at == 0 && before_white,
                _ => false,
            };
            breaks |= is_break(c);
            special |= c != '\n' && !is_printable(c);
            break_space |= c == ' ' && behind_break;
            space_break |= is_break(c) && behind_space;
            (behind_space, behind_break, behind_white) = (c == ' ', is_break(c), is_white(c));
        }
        let is_bare = |c: char| c == ' ' || is_break(c);
        let bare_ends = value.starts_with(is_bare) || value.ends_with(is_bare);
        let single = !(break_space || space_break || special);
        Self { plain: single && !(bare_ends || breaks || indicators), single }
    }
}

fn is_break(c: char) -> bool {
    matches!(c, '\n' | '\u{85}' | '\u{2028}' | '\u{2029}')
}

fn is_white(c: char) -> bool {
    is_break(c) || matches!(c, '\0' | ' ' | '\t' | '\r')
}

fn is_printable(c: char) -> bool {
    matches!(c, ' '..='~' | '\u{85}' | '\u{a0}'..='\u{fffd}' | '\u{10000}'..='\u{10fffe}') && c != '\u{feff}'
}

/// A line break is written twice: one alone would be read as a space.
fn single(value: &str, indent: usize) -> String {
    let mut out = String::from("'");
    let mut rest = value.chars().peekable();
    let mut behind_break = false;
    while let Some(c) = rest.next() {
        if is_break(c) && !behind_break && c == '\n' {
            out.push('\n');
        }
        if c == '\'' {
            out.push('\'');
        }
        out.push(c);
        behind_break = is_break(c);
        if behind_break && rest.peek().is_none_or(|next| !is_break(*next)) {
            out.extend(std::iter::repeat_n(' ', indent));
        }
    }
    out.push('\'');
    out
}

fn double(value: &str) -> String {
    let mut out = String::from("\"");
    for c in value.chars() {
        let short = match c {
            '\0' => '0',
            '\x07' => 'a',
            '\x08' => 'b',
            '\t' => 't',
            '\n' => 'n',
            '\x0b' => 'v',
            '\x0c' => 'f',
            '\r' => 'r',
            '\x1b' => 'e',
            '"' => '"',
            '\\' => '\\',
            '\u{85}' => 'N',
            '\u{2028}' => 'L',
            '\u{2029}' => 'P',
            ' '..='~' | '\u{a0}'..='\u{fffd}' if c != '\u{feff}' => {
                out.push(c);
                continue;
            }
            '\0'..='\u{ff}' => {
                out += &format!("\\x{:02X}", c as u32);
                continue;
            }
            '\u{100}'..='\u{ffff}' => {
                out += &format!("\\u{:04X}", c as u32);
                continue;
            }
            _ => {
                out += &format!("\\U{:08X}", c as u32);
                continue;
            }
        };
        out.extend(['\\', short]);
    }
    out.push('"');
    out
}

#[cfg(test)]
#[path = "../../../tests/unit/ros/yaml/scalar.rs"]
mod tests;
