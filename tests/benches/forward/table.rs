//! Results as text: a table a figure, then its ratios.

use std::fmt;

use crate::figure::{Aim, Figure, Measure, Ratio};

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit.name();
        writeln!(f, "\n{} [{}]", self.title, self.name)?;
        writeln!(f, "  {:<30}{:<34}{unit:>9}{:>21}", "", "", "min … max")?;
        for Measure { series, case, spread, lost_percent, .. } in &self.measures {
            let [median, low, high] = [spread.median, spread.low, spread.high].map(|value| self.unit.number(value));
            let range = format!("{low} … {high}");
            let lost = lost_percent.filter(|lost| *lost > 0.0).map(|lost| format!("  {lost:.2} % lost"));
            writeln!(f, "  {series:<30}{case:<34}{median:>9}{range:>21}{}", lost.unwrap_or_default())?;
        }
        for Ratio { series, over, case, spread, aim, met } in &self.ratios {
            write!(f, "  {series} / {over}, {case}: {:.2} × ({:.2} … {:.2})", spread.median, spread.low, spread.high)?;
            match aim {
                Some(Aim::AtLeast(aim)) => write!(f, ", aim ≥ {aim}")?,
                Some(Aim::AtMost(aim)) => write!(f, ", aim ≤ {aim}")?,
                None => {}
            }
            writeln!(f, "{}", if *met == Some(false) { ": MISSED" } else { "" })?;
        }
        Ok(())
    }
}
