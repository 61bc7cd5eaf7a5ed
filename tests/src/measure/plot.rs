//! Results as pictures: measurements in `NAME.svg`, ratios and their aims in `NAME-ratios.svg`.

use std::path::Path;

use anyhow::{Context, Result};

use super::figure::{Figure, Measure, Ratio, Verdict};
use super::svg::{Chart, Group, Row};

const BLUE: &str = "#4878a8";
const ORANGE: &str = "#d9822b";
const GREY: &str = "#a0a0a0";
/// Colours of a row's segments, from left to right.
const SEGMENTS: [&str; 4] = [GREY, BLUE, ORANGE, "#6a9955"];

/// Scale factor that leaves room for the text behind the longest bar.
const FULL: f64 = 1.15;

/// Draws the plots of all figures, replacing earlier ones.
pub fn draw(figures: &[Figure], folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for figure in figures {
        let values = if figure.stacked.is_empty() { values(figure) } else { stacks(figure) };
        write(folder, figure.name, &values)?;
        if !figure.ratios.is_empty() {
            write(folder, &format!("{}-ratios", figure.name), &ratios(figure))?;
        }
    }
    Ok(())
}

/// Returns a chart with a group per case and a bar per series.
fn values(figure: &Figure) -> Chart {
    let longest =
        |measure: &Measure| measure.spread.high.max(measure.verdict.map_or(0.0, |verdict| verdict.aim.value()));
    let full = FULL * figure.measures.iter().map(longest).filter(|value| value.is_finite()).fold(0.0, f64::max);
    let groups = distinct(figure.measures.iter().map(|measure| &*measure.case)).into_iter().map(|case| {
        let rows = figure.measures.iter().filter(|measure| measure.case == case).map(|measure| Row {
            label: measure.series.to_owned(),
            segments: vec![(measure.spread.median, colour(measure.verdict, BLUE))],
            spread: Some((measure.spread.low, measure.spread.high)),
            mark: measure.verdict.map(|verdict| verdict.aim.value()),
            text: figure.unit.show(measure.spread.median)
                + &aim(measure.verdict, |aim| figure.unit.number(aim))
                + &lost(measure),
        });
        Group { heading: case.to_owned(), full, rows: rows.collect() }
    });
    Chart { title: figure.title.clone(), legend: Vec::new(), groups: groups.collect() }
}

/// Returns a chart with a bar per case; its segments are what each series adds to the previous one.
fn stacks(figure: &Figure) -> Chart {
    let full = FULL * figure.measures.iter().map(|measure| measure.spread.median).fold(0.0, f64::max);
    let rows = distinct(figure.measures.iter().map(|measure| &*measure.case)).into_iter().map(|case| {
        let (mut segments, mut below) = (Vec::new(), 0.0);
        for ((series, _), colour) in figure.stacked.iter().zip(SEGMENTS) {
            let Some(measure) = figure.measure(series, case) else { continue };
            segments.push((measure.spread.median - below, colour));
            below = measure.spread.median;
        }
        let parts: Vec<String> = segments.iter().map(|(length, _)| format!("{length:.0}")).collect();
        let text = format!("{} = {}", parts.join(" + "), figure.unit.show(below));
        Row { label: case.to_owned(), segments, spread: None, mark: None, text }
    });
    let groups = vec![Group { heading: String::new(), full, rows: rows.collect() }];
    let legend = SEGMENTS.iter().zip(&figure.stacked).map(|(colour, (_, adds))| (*colour, (*adds).to_owned()));
    Chart { title: figure.title.clone(), legend: legend.collect(), groups }
}

/// Returns a chart with a group for each compared pair, and a bar per case.
fn ratios(figure: &Figure) -> Chart {
    let pair = |ratio: &Ratio| format!("{} over {}", ratio.series, ratio.over);
    let pairs: Vec<String> = figure.ratios.iter().map(pair).collect();
    let groups = distinct(pairs.iter().map(String::as_str)).into_iter().map(|heading| {
        let of_pair = || figure.ratios.iter().filter(|ratio| pair(ratio) == heading);
        let longest =
            of_pair().map(|ratio| ratio.spread.high.max(ratio.verdict.map_or(0.0, |verdict| verdict.aim.value())));
        Group {
            heading: heading.to_owned(),
            full: FULL * longest.filter(|value| value.is_finite()).fold(0.0, f64::max),
            rows: of_pair().map(ratio_row).collect(),
        }
    });
    let legend = [
        (BLUE, "aim (tick) met".to_owned()),
        (ORANGE, "aim missed".to_owned()),
        (GREY, "no aim; thin lines: lowest to highest of the rounds".to_owned()),
    ];
    Chart { title: format!("{}: ratios", figure.title), legend: legend.into(), groups: groups.collect() }
}

fn ratio_row(ratio: &Ratio) -> Row {
    Row {
        label: ratio.case.clone(),
        segments: vec![(ratio.spread.median, colour(ratio.verdict, GREY))],
        spread: Some((ratio.spread.low, ratio.spread.high)),
        mark: ratio.verdict.map(|verdict| verdict.aim.value()),
        text: format!("{:.2} ×{}", ratio.spread.median, aim(ratio.verdict, |aim| aim.to_string())),
    }
}

fn colour(verdict: Option<Verdict>, without: &'static str) -> &'static str {
    match verdict {
        Some(Verdict { met: false, .. }) => ORANGE,
        Some(_) => BLUE,
        None => without,
    }
}

fn aim(verdict: Option<Verdict>, number: impl Fn(f64) -> String) -> String {
    verdict.map_or(String::new(), |verdict| format!(" (aim {})", verdict.aim.shown(number)))
}

fn lost(measure: &Measure) -> String {
    let lost = measure.lost_percent.filter(|lost| *lost > 0.0);
    lost.map_or(String::new(), |lost| format!(", {lost:.2} % lost"))
}

fn write(folder: &Path, name: &str, chart: &Chart) -> Result<()> {
    let file = folder.join(format!("{name}.svg"));
    std::fs::write(&file, chart.svg()).with_context(|| format!("cannot write {}", file.display()))
}

/// Returns the distinct values in the order of their first appearance.
fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = Vec::new();
    for value in values {
        if !seen.contains(&value) {
            seen.push(value);
        }
    }
    seen
}
