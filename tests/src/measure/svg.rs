//! Horizontal bars as SVG: groups of rows, each row a label, a bar of one or more segments, and a
//! text. The same input yields the same bytes. This module does not know what was measured.

use std::fmt::Write;

/// A drawing, from top to bottom.
pub struct Chart {
    pub title: String,
    /// Colours and their meanings; may be empty.
    pub legend: Vec<(&'static str, String)>,
    pub groups: Vec<Group>,
}

/// Rows under a heading, on one scale from 0.
pub struct Group {
    pub heading: String,
    /// The value at the right end of the scale; larger values end there.
    pub full: f64,
    pub rows: Vec<Row>,
}

pub struct Row {
    pub label: String,
    /// Lengths and colours, in order.
    pub segments: Vec<(f64, &'static str)>,
    /// A thin line from one value to another.
    pub spread: Option<(f64, f64)>,
    /// A tick across the bar.
    pub mark: Option<f64>,
    /// The text behind the bar.
    pub text: String,
}

const WIDTH: f64 = 760.0;
const MARGIN: f64 = 16.0;
/// Horizontal positions where bars begin and end.
const BARS: (f64, f64) = (210.0, 560.0);
const LINE: f64 = 20.0;
const BAR: f64 = 13.0;

impl Chart {
    pub fn svg(&self) -> String {
        let mut body = String::new();
        let mut y = MARGIN + 14.0;
        text(&mut body, (MARGIN, y), "font-size=\"15\" font-weight=\"bold\"", &self.title);
        for (colour, meaning) in &self.legend {
            y += LINE;
            rectangle(&mut body, (MARGIN, y - 11.0), (12.0, 12.0), colour);
            text(&mut body, (MARGIN + 18.0, y), "", meaning);
        }
        for group in &self.groups {
            y += LINE * 1.6;
            text(&mut body, (MARGIN, y), "font-weight=\"bold\"", &group.heading);
            for row in &group.rows {
                y += LINE;
                row.draw(&mut body, y, group.full);
            }
        }
        let height = y + MARGIN;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {WIDTH} {height:.0}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{body}</svg>\n"
        )
    }
}

impl Row {
    /// Draws the row. `y`: the baseline of its text.
    fn draw(&self, out: &mut String, y: f64, full: f64) {
        let (top, middle) = (y - 11.0, y - 11.0 + BAR / 2.0);
        let length = |value: f64| (value.max(0.0) / full.max(f64::MIN_POSITIVE)).min(1.0) * (BARS.1 - BARS.0);
        text(out, (BARS.0 - 8.0, y), "text-anchor=\"end\"", &self.label);
        let mut x = BARS.0;
        for (value, colour) in &self.segments {
            rectangle(out, (x, top), (length(*value), BAR), colour);
            x += length(*value);
        }
        if let Some((low, high)) = self.spread {
            line(out, (BARS.0 + length(low), middle), (BARS.0 + length(high), middle), 1.0);
            x = x.max(BARS.0 + length(high));
        }
        if let Some(mark) = self.mark {
            let at = BARS.0 + length(mark);
            line(out, (at, top - 2.0), (at, top + BAR + 2.0), 2.0);
            x = x.max(at);
        }
        text(out, (x + 6.0, y), "", &self.text);
    }
}

fn rectangle(out: &mut String, (x, y): (f64, f64), (width, height): (f64, f64), colour: &str) {
    // Writing to a string does not fail.
    let _ = writeln!(
        out,
        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{colour}\"/>"
    );
}

fn line(out: &mut String, (x1, y1): (f64, f64), (x2, y2): (f64, f64), width: f64) {
    let _ = writeln!(
        out,
        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"#222222\" \
         stroke-width=\"{width}\"/>"
    );
}

fn text(out: &mut String, (x, y): (f64, f64), attributes: &str, content: &str) {
    let content = content.replace('&', "&amp;").replace('<', "&lt;");
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"#222222\" {attributes}>{content}</text>");
}
