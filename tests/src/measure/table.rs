//! Results as text: a table per figure, then its ratios.

use std::fmt;

use super::figure::{Figure, Measure, Ratio, Verdict};

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit.name();
        writeln!(f, "\n{} [{}]", self.title, self.name)?;
        writeln!(f, "  {:<30}{:<40}{unit:>9}{:>21}", "", "", "min … max")?;
        for Measure { series, case, spread, lost_percent, verdict, .. } in &self.measures {
            let [median, low, high] = [spread.median, spread.low, spread.high].map(|value| self.unit.number(value));
            let range = format!("{low} … {high}");
            let lost = lost_percent.filter(|lost| *lost > 0.0).map(|lost| format!("  {lost:.2} % lost"));
            write!(f, "  {series:<30}{case:<40}{median:>9}{range:>21}{}", lost.unwrap_or_default())?;
            writeln!(f, "{}", shown(*verdict, |aim| self.unit.number(aim)))?;
        }
        for Ratio { series, over, case, spread, verdict } in &self.ratios {
            write!(f, "  {series} / {over}, {case}: {:.2} × ({:.2} … {:.2})", spread.median, spread.low, spread.high)?;
            writeln!(f, "{}", shown(*verdict, |aim| aim.to_string()))?;
        }
        Ok(())
    }
}

fn shown(verdict: Option<Verdict>, number: impl Fn(f64) -> String) -> String {
    let Some(Verdict { aim, met }) = verdict else { return String::new() };
    format!(", aim {}{}", aim.shown(number), if met { "" } else { ": MISSED" })
}
